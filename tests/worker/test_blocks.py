"""Blocks executed in a worker come out as inside the node, whatever happens to the worker and to the ledger meanwhile."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from contracts.execution.views import ContractViews
from contracts.vm import InternalFault
from contracts.worker.sandbox import PARTS
from contracts.worker.worker_machine import WorkerMachine, WorkerSpec, WorkerViews
from network.ledger_diff.block_replay import base_of_genesis
from network.provisioning.network_layout import create_network
from node.config import load_config
from node.execution.sandboxed_contracts import open_sandboxed_machine
from node.storage.lmdb_reader import LedgerFile
from tests.worker.conftest import Start
from tests.worker.written_blocks import Chain


def test_the_whole_sandbox_is_there_on_this_system(start: Start) -> None:
    machine = start()
    assert machine.describe()["missing"] == {}
    assert [part.name for part in machine.greet()] == list(PARTS)
    status = Path(f"/proc/{machine.describe()['pid']}/status").read_text()
    facts = dict(line.split(":\t", 1) for line in status.splitlines())
    assert facts["Seccomp"] == "2"
    assert facts["NoNewPrivs"] == "1"
    assert int(facts["CapEff"], 16) == int(facts["CapPrm"], 16) == 0


def test_a_worker_holds_its_pipe_and_the_ledger_for_reading_and_nothing_else(start: Start, tmp_path: Path) -> None:
    place = Path(f"/proc/{start().describe()['pid']}")
    found = {int(path.name): str(path.readlink()) for path in (place / "fd").iterdir()}
    assert found.pop(0).startswith("pipe:")
    assert found.pop(1).startswith("pipe:")
    assert found.pop(2).startswith("pipe:")
    [(number, name)] = found.items()
    assert name == str(tmp_path / "ledger" / "data.mdb")
    flags = int(dict(line.split(":\t") for line in (place / f"fdinfo/{number}").read_text().splitlines())["flags"], 8)
    assert flags & os.O_ACCMODE == os.O_RDONLY
    maps = (place / "maps").read_text().splitlines()
    assert [line.split()[1] for line in maps if line.endswith("data.mdb")] == ["r--s"]
    assert not [line for line in maps if line.endswith("lock.mdb")]
    assert (place / "environ").read_bytes() == b""


async def test_a_branch_grows_above_the_ledger_and_the_ledger_follows(
    chain: Chain, start: Start, lost: list[str]
) -> None:
    machine = start()
    for _ in range(12):
        chain.add(machine)
        if chain.height % 4 == 0:
            await chain.store_up_to(chain.height - 2)
            chain.rebase()
    assert lost == []


async def test_a_block_on_an_old_parent_comes_out_right_though_the_worker_reads_a_newer_ledger(
    chain: Chain, start: Start
) -> None:
    """The worker cannot go back: it asks the node for the rows of the parent's state."""
    machine = start()
    old = chain.view
    rivals = chain.registrations()
    for _ in range(3):
        chain.add(machine)
    await chain.store_up_to(3)
    chain.check(machine, chain.registrations())
    chain.check(machine, rivals, old)
    chain.check(machine, chain.registrations())


async def test_two_branches_are_executed_in_turns(chain: Chain, start: Start) -> None:
    machine = start()
    chain.add(machine)
    forked = chain.view
    for _ in range(3):
        chain.check(machine, chain.registrations(), forked)
        chain.add(machine)


async def test_an_empty_block_and_one_that_fails_come_out_alike(chain: Chain, start: Start) -> None:
    machine = start()
    chain.check(machine, [])
    [first] = chain.registrations(1)
    chain.check(machine, [first, first])


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
async def test_a_killed_worker_is_replaced_and_its_branch_goes_on(
    chain: Chain, start: Start, lost: list[str], number: signal.Signals
) -> None:
    machine = start()
    for _ in range(3):
        chain.add(machine)
        os.kill(machine.describe()["pid"], number)
        chain.add(machine)
    await chain.store_up_to(5)
    chain.rebase()
    chain.add(machine)
    assert lost == [f"it ended by signal {number}"] * 3
    assert machine.describe()["replaced"] == 3


async def test_a_worker_killed_at_work_is_replaced_and_the_block_executed_again(
    chain: Chain, start: Start, lost: list[str]
) -> None:
    """The kill comes a little later each time, before the block, in it and behind it."""
    machine = start()
    transactions = chain.registrations(60)
    for delay_ms in range(0, 40, 4):
        pid = machine.describe()["pid"]
        killer = threading.Timer(delay_ms / 1000, lambda pid=pid: os.kill(pid, signal.SIGKILL))
        killer.start()
        chain.check(machine, transactions)
        killer.join()
        chain.check(machine, transactions)
    assert set(lost) == {"it ended by signal 9"}
    assert len(lost) == 10


async def test_a_stopped_worker_is_given_up_and_replaced(chain: Chain, start: Start, lost: list[str]) -> None:
    machine = start(stalled_max_ms=1200)
    chain.add(machine)
    os.kill(machine.describe()["pid"], signal.SIGSTOP)
    chain.add(machine)
    assert lost == ["it hangs"]


async def test_a_build_leaves_out_nothing_that_is_sound(chain: Chain, start: Start) -> None:
    machine = start()
    transactions = chain.registrations(3)
    place = (chain.view, 1, chain.time_ms(1), transactions)
    assert machine.build(*place) == chain.inside.build(*place)


async def test_a_refused_block_is_refused_with_its_code(chain: Chain, start: Start, lost: list[str]) -> None:
    machine = start()
    [one] = chain.registrations(1)
    with pytest.raises(BlockRobotError, match="BLOCK_INVALID"):
        machine.verify(chain.view, 1, chain.time_ms(1), [one] * 257)
    assert lost == []


async def test_views_answer_on_the_snapshot_that_is_asked_about(chain: Chain, start: Start, staff: WorkerSpec) -> None:
    machine, views = start(), WorkerViews(staff)
    inside = ContractViews(chain.genesis)
    try:
        chain.add(machine)
        await chain.store_up_to(1)
        member = chain.hospital.registrar.public_key
        for snapshot in (chain._snapshot, chain.store.snapshot()):
            assert snapshot is not None
            with snapshot:
                position = snapshot.position
                assert position is not None
                question = (position.height, position.timestamp_ms, "identity", "role_of", [member])
                expected = inside.run(snapshot, *question)
                assert views.run_view(snapshot, snapshot.state_root, *question) == expected
                with pytest.raises(BlockRobotError, match="TRANSACTION_CONTRACT_UNKNOWN"):
                    views.run_view(snapshot, snapshot.state_root, *question[:2], "identity", "no_such", [])
    finally:
        views.close()


def test_a_worker_that_cannot_start_is_named(start: Start, lost: list[str]) -> None:
    with pytest.raises(BlockRobotError, match=r"CONTRACT_WORKER_FAILED.*ended with code 3"):
        start(command=(sys.executable, "-I", "-c", "raise SystemExit(3)"))
    with pytest.raises(BlockRobotError, match=r"CONTRACT_WORKER_FAILED.*no process"):
        start(command=("/nowhere/python",))
    assert len(lost) >= 6


def test_a_worker_that_speaks_nonsense_is_replaced(chain: Chain, start: Start) -> None:
    with pytest.raises(BlockRobotError, match=r"CONTRACT_WORKER_FAILED.*(nonsense|began|begin)"):
        start(command=(sys.executable, "-I", "-c", "import sys; sys.stdin.read(4); print('no frame at all' * 99)"))


async def test_no_block_is_executed_once_the_node_closes(chain: Chain, start: Start) -> None:
    machine = start()
    machine.close()
    with pytest.raises(InternalFault, match="closing"):
        machine.verify(chain.view, 1, chain.time_ms(1), [])


async def test_blocks_executed_ahead_come_out_as_one_by_one(chain: Chain, start: Start, lost: list[str]) -> None:
    machine, first = start(), chain.view
    blocks, results = chain.run(6)
    assert machine.verify_ahead(first, blocks) == results
    assert machine.verify_ahead(first, []) == []
    chain.add(machine)  # on what the worker keeps of the run
    assert lost == []


async def test_a_run_ends_before_what_fails_or_stands_on_another_root(chain: Chain, start: Start) -> None:
    machine, first = start(), chain.view
    blocks, results = chain.run(4)
    elsewhere = replace(blocks[1], state_root=bytes(32))
    assert machine.verify_ahead(first, [blocks[0], elsewhere, *blocks[2:]]) == results[:2]
    overfull = replace(blocks[2], transactions=list(blocks[2].transactions) * 200)
    assert machine.verify_ahead(first, [*blocks[:2], overfull, blocks[3]]) == results[:2]
    assert machine.verify_ahead(first, [overfull, *blocks]) == []
    with pytest.raises(BlockRobotError) as caught:
        machine.verify(first, overfull.height, overfull.time_ms, overfull.transactions)
    assert caught.value.code == "BLOCK_INVALID"


async def test_a_worker_that_knows_no_state_but_the_asked_one_guesses_nothing(chain: Chain, start: Start) -> None:
    machine = start()
    chain.run(1)
    first = chain.view  # the worker never saw that block: it asks back for each row
    blocks, results = chain.run(3)
    assert machine.verify_ahead(first, blocks) == results[:1]
    machine.verify(first, blocks[0].height, blocks[0].time_ms, blocks[0].transactions)


async def test_a_worker_lost_with_a_run_is_replaced_and_the_run_left_to_single_blocks(
    chain: Chain, start: Start, lost: list[str]
) -> None:
    machine, first = start(), chain.view
    blocks, results = chain.run(2)
    os.kill(machine.describe()["pid"], signal.SIGKILL)
    assert machine.verify_ahead(first, blocks) == []
    assert lost == ["it ended by signal 9"]
    assert machine.verify(first, blocks[0].height, blocks[0].time_ms, blocks[0].transactions) == results[0]
    assert machine.verify_ahead(first, blocks) == results
    machine.close()
    with pytest.raises(InternalFault, match="closing"):
        machine.verify_ahead(first, blocks)


async def test_a_tool_that_reads_a_ledger_executes_its_blocks_in_the_sandbox(chain: Chain, tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=46_480)
    config = replace(load_config(tmp_path / "network" / "nodes" / "node-1"), data_dir=tmp_path / "tool")
    shutil.copytree(tmp_path / "ledger", config.ledger_dir)  # LMDB opens a file once in a process
    with LedgerFile(config.ledger_dir) as ledger, open_sandboxed_machine(config, chain.genesis, ledger) as machine:
        assert isinstance(machine, WorkerMachine)
        replayed = base_of_genesis(chain.genesis).state
        for _ in range(3):
            transactions = chain.registrations()
            place = (replayed, chain.height + 1, chain.time_ms(chain.height + 1), transactions)
            result = machine.verify(*place)
            assert result == chain.inside.verify(*place)
            replayed.absorb(result.writes, result.page_writes, result.state_root)
            chain.put(result)
        assert machine.describe()["replaced"] == 0
