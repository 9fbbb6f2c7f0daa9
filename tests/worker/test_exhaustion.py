"""A worker that runs out of memory or time gives no verdict; what others executed gets more and more of both."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

from consensus.chain.transaction import Transaction
from contracts.execution.results import BlockResult, ExecutionFault
from contracts.worker import worker_machine
from contracts.worker.handle import ENDLESS
from contracts.worker.wire import Begin
from contracts.worker.worker_machine import EFFORT_MAX, WorkerSpec
from tests.worker.conftest import Start
from tests.worker.holed_worker import MARK, TAKE
from tests.worker.written_blocks import Chain

COMMAND = (sys.executable, "-I", str(Path(__file__).with_name("holed_worker.py")))
MIB = 1024**2
MEMORY_MIB = 64


@pytest.fixture
def weak(start: Start, staff: WorkerSpec) -> worker_machine.WorkerMachine:
    """A machine whose worker may take 64 MiB."""
    begin = Begin(staff.begin.genesis_json, staff.begin.ledger_dir, MEMORY_MIB * MIB)
    return start(command=COMMAND, begin=begin)


def put(chain: Chain, key: bytes, data: bytes) -> Transaction:
    return chain.hospital.sign(chain.hospital.admin, "hole", "put", key, data)


def taking(chain: Chain, size_mib: int) -> Transaction:
    return put(chain, b"taking", TAKE + b"%d" % (size_mib * MIB))


def verify(
    chain: Chain, machine: worker_machine.WorkerMachine, *transactions: Transaction, effort: int = 0
) -> BlockResult:
    return machine.verify(chain.view, 1, chain.time_ms(1), list(transactions), effort=effort)


async def test_a_call_without_memory_gets_no_receipt_and_ends_its_worker(
    chain: Chain, weak: worker_machine.WorkerMachine, lost: list[str]
) -> None:
    sound, greedy = put(chain, b"a", b"1"), taking(chain, 2 * MEMORY_MIB)
    before = weak.describe()["pid"]
    with pytest.raises(ExecutionFault, match="MemoryError") as caught:
        verify(chain, weak, sound, greedy)
    assert (caught.value.txid, caught.value.in_change) == (greedy.txid, False)
    assert lost
    result, culprits = weak.build(chain.view, 1, chain.time_ms(1), [sound, greedy])
    assert culprits == [greedy.txid]
    assert [receipt.txid for receipt in result.receipts] == [sound.txid]
    assert weak.describe()["pid"] != before
    assert verify(chain, weak, sound).receipts == result.receipts


async def test_each_effort_may_take_twice_the_memory_and_the_last_one_all(
    chain: Chain, weak: worker_machine.WorkerMachine
) -> None:
    for size_mib, fails, suffices in ((100, 0, 1), (200, 1, 2), (1200, EFFORT_MAX, EFFORT_MAX + 1)):
        greedy = taking(chain, size_mib)
        with pytest.raises(ExecutionFault):
            verify(chain, weak, greedy, effort=fails)
        assert verify(chain, weak, greedy, effort=suffices).receipts[0].ok
    with pytest.raises(ExecutionFault):
        verify(chain, weak, taking(chain, 100))


async def test_a_call_that_does_not_come_to_an_end_is_given_up_at_once(
    chain: Chain, start: Start, monkeypatch: pytest.MonkeyPatch, lost: list[str]
) -> None:
    monkeypatch.setattr(worker_machine, "PROCESSOR_MAX_MS", 400)
    machine = start(command=COMMAND)
    endless = put(chain, b"x", MARK + b"any(False for _ in iter(int, 1))")
    began = time.process_time()
    with pytest.raises(ExecutionFault, match=ENDLESS) as caught:
        verify(chain, machine, endless)
    assert caught.value.txid == endless.txid
    assert lost == [ENDLESS]
    assert time.process_time() - began < 5
    assert verify(chain, machine, put(chain, b"a", b"1")).receipts[0].ok


async def test_a_worker_killed_again_and_again_gives_a_fault_or_the_right_result(
    chain: Chain, start: Start, lost: list[str]
) -> None:
    machine = start()
    transactions = chain.registrations(40)
    expected = chain.inside.verify(chain.view, 1, chain.time_ms(1), transactions)
    stop = threading.Event()

    def kill() -> None:
        while not stop.wait(0.15):
            pid = machine.describe()["pid"]
            if pid:
                os.kill(pid, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        for number in range(500):
            if lost and number >= 12:
                break
            try:
                assert machine.verify(chain.view, 1, chain.time_ms(1), transactions) == expected
            except ExecutionFault:
                continue
    finally:
        stop.set()
        killer.join()
    assert lost
    assert machine.verify(chain.view, 1, chain.time_ms(1), transactions) == expected
