"""Sources of others are executed in a sandboxed process, never in the one that runs the tests."""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from contracts.kit import Chain, chain, sandboxed, worker
from contracts.kit.engine import Engine
from contracts.kit.sandboxed import SandboxedEngine
from contracts.worker.sandbox import REQUIRED_PARTS
from tests.unit.contracts.kit.test_chain import COUNTER

SOURCE = "@export\ndef f(n: int) -> int:\n    return n\n"


def test_the_sandbox_is_that_of_nodes_and_the_process_of_the_tests_cannot_execute_a_contract() -> None:
    engine = SandboxedEngine()
    wanted = REQUIRED_PARTS if sys.platform == "linux" else frozenset()
    assert {part.name for part in engine.parts if part.had} >= wanted
    assert engine.pid != os.getpid()
    # What compiles and executes is imported by modules that the sandboxed process alone asks.
    for module in (chain, sandboxed):
        text = Path(module.__file__ or "").read_text(encoding="utf-8")
        assert not re.search(r"compile_contract|import .*\binvoke\b|(?<!Sandboxed)Engine\(|MemoryState", text)


def test_chains_know_nothing_of_each_other_and_leave_nothing() -> None:
    first, second = Chain(), Chain()
    for one in (first, second):
        one.deploy_source(COUNTER, "counter")
    first.call("counter", "add", 1, [1])
    assert (first.state("counter"), second.state("counter")) == ({b"total": 1}, {})
    assert first.state_root != second.state_root
    del first
    gc.collect()
    assert second.call("counter", "add", 1, [1]).result[0] == 1


def test_a_process_that_is_killed_is_told_with_a_code_and_the_next_chain_has_another() -> None:
    broken = Chain()
    broken.deploy_source(SOURCE, "f")
    os.kill(SandboxedEngine().pid, signal.SIGKILL)
    for _ in range(2):
        with pytest.raises(BlockRobotError, match=r"^CONTRACT_WORKER_FAILED:"):
            broken.call("f", "f", 1)
    again = Chain()
    again.deploy_source(SOURCE, "f")
    assert again.call("f", "f", 2).result == 2


def test_an_interpreter_that_is_not_there_is_told_with_a_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sandboxed, "_workers", [])
    monkeypatch.setattr(sandboxed, "WORKER_MODULE", "no_such_module")
    with pytest.raises(BlockRobotError, match=r"^CONTRACT_WORKER_FAILED:"):
        Chain()


def test_a_worker_makes_each_chain_once_and_forgets_it(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Engine] = []

    def make() -> Engine:
        made.append(Engine())
        return made[-1]

    monkeypatch.setattr(worker, "Engine", make)
    engines: dict[int, Engine] = {}
    for number in (1, 1, 2, 1):
        assert worker.answer(engines, worker.ReadFigures(number)).refused is None
    assert list(engines.values()) == made
    assert len(made) == 2
    worker.answer(engines, worker.Forget(1))
    worker.answer(engines, worker.Forget(3))
    assert (list(engines), len(made)) == ([2], 2)
