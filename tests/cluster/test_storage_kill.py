"""A real process is killed while it stores blocks: nothing that it called safe is lost, and the state is whole."""

from __future__ import annotations

import importlib.util
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

from contracts.state.trie import compute_root
from contracts.state.view import MemoryState
from node.consensus.journal import Journal
from node.storage.ledger_store import EventCursor, TransactionLocation
from node.storage.lmdb_store import LmdbStore

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = Path(__file__).with_name("storage_writer.py")
KILLS_COUNT = 8

_spec = importlib.util.spec_from_file_location("storage_writer", SCRIPT)
writer = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(writer)


def run_and_kill(directory: Path, moment_s: float) -> tuple[int, int]:
    """Let the writer work until some time after its first promises, kill it; return what it called safe last."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(SCRIPT), str(directory)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment) as process:
        lines = [process.stdout.readline()]
        while lines[-1] and len({line.split()[0] for line in lines}) < 2:
            lines.append(process.stdout.readline())
        time.sleep(moment_s)
        process.send_signal(signal.SIGKILL)
        lines += process.stdout.readlines()
        assert process.wait() == -signal.SIGKILL
    promised = {"stored": -1, "journalled": 0}
    for line in lines:
        if line.endswith("\n"):
            what, number = line.split()
            promised[what] = int(number)
    return promised["stored"], promised["journalled"]


def oracle_at(height: int) -> MemoryState:
    state = MemoryState()
    for number in range(height + 1):
        state.apply(writer.writes_of(number))
    return state


async def check_ledger(directory: Path, promised: int) -> int:
    """Check that the ledger holds every promised block, whole, and the state of its newest; return its height."""
    store = LmdbStore.open(directory)
    height = -1 if store.position is None else store.position.height
    assert height >= promised
    oracle = oracle_at(height)
    with store.snapshot() as view:
        content = list(view.scan(b"", 1_000_000))
        assert content == list(oracle.scan(b"", 1_000_000))
        assert compute_root(content) == view.state_root == oracle.state_root
        assert all(view.page(path) == page for path, page in oracle.pages.items())
        assert [number for number, _ in view.iter_blocks(0, 1_000_000)] == list(range(height + 1))
        assert len(view.events(EventCursor(0, 0), 1_000_000)) == height + 1
        for number in range(height + 1):
            assert view.block(number) == writer.digest("bytes", number) * 100
            assert view.receipts(number) == writer.digest("receipts", number)
            assert view.locate(writer.digest("tx", number, 2)) == TransactionLocation(number, 2)
        assert view.finality == writer.digest("finality", height)
        assert view.block(height + 1) is None
    await store.close()
    return height


def check_journal(path: Path, promised: int) -> int:
    journal = Journal.open(path)
    journal.close()
    assert len(journal.entries) >= promised
    for number, entry in enumerate(journal.entries, start=1):
        assert entry.sequence == number
        assert entry.record == b"%d " % number + writer.digest("vote", number) * 20
    return len(journal.entries)


async def test_nothing_that_was_called_safe_is_lost_by_kills_at_any_moment(tmp_path):
    moments = random.Random(20)
    heights, sequences = [-1], [0]
    for _ in range(KILLS_COUNT):
        stored, journalled = run_and_kill(tmp_path, moments.uniform(0.0, 0.4))
        heights.append(await check_ledger(tmp_path / "ledger", max(stored, heights[-1])))
        sequences.append(check_journal(tmp_path / "votes", max(journalled, sequences[-1])))
    assert heights[-1] > KILLS_COUNT
    assert sequences[-1] > KILLS_COUNT
