"""Blocks of simulated networks: built, executed again by the first who verifies, shared after that, and compared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from contracts.execution.results import BlockResult
from network.sim.world.sim_machine import ComparingMachine


class State:
    state_root = b"parent"


class Contracts:
    """Gives results of these roots, one after the other; an error code stands for a refusal."""

    def __init__(self, *roots: bytes | str) -> None:
        self.roots = list(roots)

    def execute(self) -> BlockResult:
        root = self.roots.pop(0)
        if isinstance(root, str):
            raise BlockRobotError(root)
        return BlockResult((), {}, {}, root, b"receipts", 0)

    def build(self, *_: object, **__: object) -> tuple[BlockResult, list[bytes]]:
        return self.execute(), []

    def verify(self, *_: object, **__: object) -> BlockResult:
        return self.execute()


def machine_of(contracts: Contracts, *, shares: bool = True) -> tuple[Any, list[str]]:
    found: list[str] = []
    machine: Any = ComparingMachine(contracts, shares=shares, on_difference=lambda _, text: found.append(text))  # type: ignore[arg-type]
    return machine, found


BLOCK: tuple[State, int, int, Sequence[Any]] = (State(), 1, 5, [])


def test_the_first_verifier_executes_what_was_built_and_the_next_is_given_its_result() -> None:
    contracts = Contracts(b"root", b"root")
    machine, found = machine_of(contracts)
    machine.build(*BLOCK)
    assert [machine.verify(*BLOCK).state_root for _ in range(3)] == [b"root"] * 3
    assert contracts.roots == []
    assert found == []


def test_whoever_executes_apart_is_given_nothing() -> None:
    contracts = Contracts(b"root", b"root", b"other")
    machine, found = machine_of(contracts, shares=False)
    machine.build(*BLOCK)
    assert [machine.verify(*BLOCK).state_root for _ in range(2)] == [b"root", b"other"]
    assert found == ["block 1 was executed twice, with different state root"]


def test_a_block_that_comes_out_otherwise_than_it_was_built_is_told() -> None:
    machine, found = machine_of(Contracts(b"root", b"other"))
    machine.build(*BLOCK)
    assert machine.verify(*BLOCK).state_root == b"other"
    assert found == ["block 1 was executed twice, with different state root"]


def test_a_block_that_was_built_and_is_refused_is_told() -> None:
    machine, found = machine_of(Contracts(b"root", "BLOCK_INVALID"))
    machine.build(*BLOCK)
    with pytest.raises(BlockRobotError):
        machine.verify(*BLOCK)
    assert found == ["block 1 was executed once, and refused another time: BLOCK_INVALID"]
