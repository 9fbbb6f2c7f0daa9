"""Contracts by state: what the table names and nothing else, compiled once, and loudly missed if it is not there."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value, u32
from consensus.state.lifecycle import MACHINE_SOURCE, MACHINE_TABLE, SOURCE
from contracts.lifecycle.catalogue import Catalogue, read_source_of
from contracts.lifecycle.registry import SHIPPED_CONTRACTS, compute_source_hash
from contracts.state.view import MemoryState
from contracts.vm.compiler import compile_cache
from tests.unit.contracts.system.consortium import Consortium
from tests.unit.contracts.system.deploying import VISITORS, VISITORS_2, agree, disabling, upgrade


@pytest.fixture
def chain() -> Consortium:
    chain = Consortium()
    upgrade(chain, "visitors", VISITORS)
    return chain


def test_each_state_has_its_own_contracts(chain: Consortium) -> None:
    """A node asks for the stored state, for those of branches above it, and for old ones that it replays."""
    before, catalogue = chain.state.copy(), Catalogue()
    upgrade(chain, "visitors", VISITORS_2)
    after = chain.state.copy()
    agree(chain, "disable", disabling("visitors", 2))
    chain.block([])
    for _ in range(2):
        old, new, resting = (catalogue.active(state) for state in (before, after, chain.state))
        assert [len(old["visitors"].entries), len(new["visitors"].entries)] == [3, 3]
        assert old["visitors"].abi.entry("leave") is not None
        assert new["visitors"].abi.entry("leave") is None
        assert "visitors" not in resting
        assert (resting.disabled, resting.versions["visitors"]) == ({"visitors"}, 2)
    assert set(resting) == set(SHIPPED_CONTRACTS)


def test_the_same_table_gives_the_very_same_contracts(chain: Consortium, monkeypatch: pytest.MonkeyPatch) -> None:
    catalogue = Catalogue()
    first = catalogue.active(chain.state)
    monkeypatch.setattr(compile_cache, "_compile", None)
    assert catalogue.active(chain.state.copy()) is first


def test_an_upgrade_compiles_that_contract_and_no_other(chain: Consortium) -> None:
    first = chain.catalogue.active(chain.state)
    upgrade(chain, "visitors", VISITORS_2)
    second = chain.catalogue.active(chain.state)
    assert [name for name in first if second[name] is not first[name]] == ["visitors"]


def test_a_state_without_a_table_or_with_an_unknown_source_is_refused(chain: Consortium) -> None:
    with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
        Catalogue().active(MemoryState())
    chain.state.apply({MACHINE_TABLE.flat: encode_value({"visitors": [1, bytes(32), True, 1]})})
    with pytest.raises(BlockRobotError, match="STORAGE_DAMAGED"):
        Catalogue().active(chain.state)


@pytest.mark.parametrize("damage", ["gone", "part", "changed"])
def test_a_source_that_is_missing_or_another_is_never_run(chain: Consortium, damage: str) -> None:
    place = MACHINE_SOURCE.key(compute_source_hash(VISITORS))
    assert read_source_of(chain.state, compute_source_hash(VISITORS)) == VISITORS
    change = {
        "gone": {place: None},
        "part": {place + b"/" + u32(0): None},
        "changed": {place + b"/" + u32(0): encode_value(VISITORS_2.encode())},
    }[damage]
    chain.state.apply({SOURCE.key(compute_source_hash(VISITORS)): None} | change)
    with pytest.raises(BlockRobotError, match="STORAGE_DAMAGED"):
        Catalogue().active(chain.state)
