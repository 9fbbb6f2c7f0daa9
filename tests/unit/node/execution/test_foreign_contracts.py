"""A chain whose contracts this version does not have: the node says so, with the sandbox and without."""

from __future__ import annotations

from types import SimpleNamespace

import msgspec
import pytest

from consensus.errors import BlockRobotError
from node.execution.sandboxed_contracts import open_contracts
from tests.unit.contracts.system.consortium import Consortium


@pytest.mark.parametrize("sandbox", ["on", "off"])
async def test_contracts_that_do_not_ship_here_are_named_as_the_reason(sandbox: str):
    genesis = msgspec.structs.replace(Consortium().genesis, contracts=())
    with pytest.raises(BlockRobotError, match="names contracts that this version of BlockRobot does not ship"):
        await open_contracts(SimpleNamespace(contract_sandbox=sandbox), genesis, None)
