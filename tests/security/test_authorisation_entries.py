"""Every entry of the shipped contracts tried by every role, and by every contract in somebody's name, on the real executor.

What is expected is what the entry's own docstring says (`contracts.execution.callers`), the same that
`docs/reference/authorisation.md` is made from. No call here is kept, so that each meets the same state.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from consensus.chain.block import Receipt
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from contracts.execution.call_host import CallHost
from contracts.execution.callers import ROLES, STRANGER, entry_rules, rule_of
from contracts.execution.executor import execute_transaction
from contracts.execution.results import PROTOCOL_LIMITS, BlockContext
from contracts.lifecycle.registry import SHIPPED_CONTRACTS, SYSTEM_CONTRACTS, read_source
from contracts.vm import CompiledContract, compile_contract
from tests.unit.contracts.privacy import callers as privacy
from tests.unit.contracts.system import callers as system

pytestmark = pytest.mark.smoke

FAULTS = {"TYPE_ERROR", "KEY_ERROR", "VALUE_ERROR", "OUT_OF_GAS", "NAME_UNSET", "ARGUMENTS_INVALID"}
RULES = entry_rules()
BY_CONTRACT = [place for place, rule in RULES.items() if rule.contracts]
IN_SOMEBODYS_NAME = """

@export
def in_somebodys_name(contract: str, entry: str, arguments: list):
    \"\"\"Call another contract in the caller's name.\"\"\"
    count = len(arguments)
    if count == 1:
        call(contract, entry, arguments[0])
    elif count == 2:
        call(contract, entry, arguments[0], arguments[1])
    elif count == 3:
        call(contract, entry, arguments[0], arguments[1], arguments[2])
    else:
        call(contract, entry, arguments[0], arguments[1], arguments[2], arguments[3])
"""


class Stage:
    """One chain with everybody on it, what each entry is called with, and who holds which role."""

    def __init__(self, of_system: bool) -> None:
        self.scene: Any = system.Scene() if of_system else privacy.Scene(privacy.Hospital())
        self.chain: Any = self.scene.chain if of_system else self.scene.hospital
        self.rows = system.RULES if of_system else privacy.RULES
        self.roles = system.ROLE_OF if of_system else privacy.ROLE_OF
        self.contracts: dict[str, CompiledContract] = dict(self.chain.contracts)
        self.everyone: dict[str, PrivateKey] = self.scene.everyone

    def rows_of(self, place: tuple[str, str]) -> list[tuple[list[Any], set[str]]]:
        """Return arguments of an entry, and by whom they are accepted."""
        return [(arguments(self.scene), allowed) for *entry, arguments, allowed in self.rows if tuple(entry) == place]

    def call(self, key: PrivateKey, contract: str, entry: str, *values: Any, **later: Any) -> Receipt:
        """Execute one transaction on the state as it is, and keep nothing."""
        delay_ms = privacy.LATER_MS.get((contract, entry), 0)
        self.chain.time_ms += delay_ms
        transaction = self.chain.sign(key, contract, entry, *values)
        self.chain.time_ms -= delay_ms
        time_ms = self.chain.time_ms + 100 + delay_ms
        context = BlockContext(chain_id=self.chain.chain_id, height=self.chain.height + 1, time_ms=time_ms)
        contracts = later.get("contracts", self.contracts)
        gas = PROTOCOL_LIMITS.call_gas
        return execute_transaction(CallHost(self.chain.state), contracts, context, transaction, gas)


@cache
def stage_of(contract: str) -> Stage:
    of_system = contract in SYSTEM_CONTRACTS
    return _stage(of_system)


@cache
def _stage(of_system: bool) -> Stage:
    return Stage(of_system)


@cache
def meddling(name: str) -> CompiledContract:
    """A contract of this name that also does for anybody what it is told."""
    source = read_source(name) if name in SHIPPED_CONTRACTS else ""
    return compile_contract(source + IN_SOMEBODYS_NAME, name)


@pytest.mark.parametrize("place", RULES, ids=".".join)
def test_each_role_may_do_what_the_rule_says_and_no_more(place: tuple[str, str]) -> None:
    stage, rule, succeeded = stage_of(place[0]), RULES[place], set()
    for values, allowed in stage.rows_of(place):
        stranger = stage.call(stage.everyone[STRANGER], *place, *values)
        for name, key in stage.everyone.items():
            receipt, role = stage.call(key, *place, *values), stage.roles[name]
            told = f"{name}: {receipt.code} {receipt.message}"
            assert receipt.code not in FAULTS, told
            assert (receipt.code == "ENTRY_UNKNOWN") == (place[1] == "genesis"), told
            assert receipt.ok == (name in allowed), told
            if receipt.ok:
                succeeded.add(role)
            elif role in rule.always:
                assert receipt.code != stranger.code, f"{told} (it is his role that was refused)"
    assert succeeded == rule.roles


@pytest.mark.parametrize("place", BY_CONTRACT, ids=".".join)
def test_only_the_contracts_of_the_rule_may_call_it_in_somebodys_name(place: tuple[str, str]) -> None:
    stage, rule = stage_of(place[0]), RULES[place]
    (values, _), *_ = stage.rows_of(place)
    refusals, passed = set(), set()
    for name in ("meddler", *sorted(set(SHIPPED_CONTRACTS) - {place[0]})):
        contracts = stage.contracts | {name: meddling(name)}
        for key in stage.everyone.values():
            receipt = stage.call(key, name, "in_somebodys_name", *place, values, contracts=contracts)
            assert receipt.code not in FAULTS | {"ENTRY_UNKNOWN"}, receipt.message
            if name not in rule.contracts:
                assert not receipt.ok, name
                refusals.add(receipt.code)
            elif receipt.code not in refusals:
                passed.add(name)
    assert len(refusals) == 1
    assert passed == rule.contracts


def test_every_entry_has_a_rule_and_is_tried_with_every_role() -> None:
    assert {tuple(row[:2]) for row in privacy.RULES + system.RULES} == set(RULES)
    for scene in (privacy, system):
        assert set(scene.ROLE_OF.values()) == set(ROLES)
    for stage in (_stage(False), _stage(True)):
        assert stage.everyone.keys() == stage.roles.keys()


@pytest.mark.parametrize("docstring", ["Do it.", "Do it. Who may call: whoever likes.", ""])
def test_an_entry_without_a_rule_that_is_known_is_an_error(docstring: str) -> None:
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID:"):
        rule_of("records", "record", docstring)
