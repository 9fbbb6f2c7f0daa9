"""Nodes whose workers fail on a call or on a version of a contract, some or all: the chain goes on, with one history."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

import pytest

from contracts.execution.contract_machine import ContractMachine
from contracts.lifecycle.changes import read_record
from contracts.lifecycle.describing import list_contracts
from contracts.lifecycle.registry import compute_source_hash
from tests.unit.contracts.system.deploying import VISITORS, VISITORS_2, activation, deployment, parts_of
from tests.unit.node.small_nodes import SmallNodes, make_genesis
from tests.unit.node.weak_machine import WeakMachine
from tests.virtual_time import in_virtual_time, virtual_now_ms

NAMES = ["a", "b", "c", "d"]
CHANGE_MAX_MS = 15_000
CALL_MAX_MS = 10_000


def weak_crowd(weak: Iterable[str], *, needs: int = 1, names: list[str] = NAMES) -> SmallNodes:
    crowd = SmallNodes(make_genesis(names))
    crowd.machines = {
        name: WeakMachine(ContractMachine.of_genesis(crowd.genesis), "visitors", needs=needs) for name in weak
    }
    return crowd


def machine(crowd: SmallNodes, name: str) -> WeakMachine:
    found = crowd.machines[name]
    assert isinstance(found, WeakMachine)
    return found


def set_weak(crowd: SmallNodes, is_weak: bool) -> None:
    for name in crowd.machines:
        machine(crowd, name).is_weak = is_weak


async def upload(crowd: SmallNodes, source: str) -> None:
    parts = parts_of(source)
    for place, data in enumerate(parts):
        part = crowd.transaction("lifecycle", "upload", compute_source_hash(source), len(parts), place, data)
        await crowd.finalize("a", part)
    await crowd.finalize("a", crowd.transaction("lifecycle", "check_upload", compute_source_hash(source)))


async def deploy(crowd: SmallNodes, source: str) -> None:
    await upload(crowd, source)
    await crowd.finalize("a", crowd.transaction("lifecycle", "propose", "deploy", deployment("visitors", source)))


async def go_on(crowd: SmallNodes, *nodes: str) -> None:
    for name in nodes or tuple(crowd.nodes):
        await crowd.finalize(name, crowd.transaction("identity", "authenticate", bytes(32)))


def status(crowd: SmallNodes, version: int, node: str = "a") -> str:
    record = read_record(crowd.nodes[node].executor.reader, "visitors", version)
    assert record is not None
    return str(record["status"])


def agree(crowd: SmallNodes) -> None:
    assert len(crowd.newest_common()) == 1
    assert not any(node.core.halted for node in crowd.nodes.values())


@pytest.mark.parametrize("weak", ["abcd", "abc", "ab", "cd"])
@in_virtual_time
async def test_a_version_that_too_few_nodes_can_put_into_force_fails_and_the_chain_goes_on(weak: str) -> None:
    crowd = weak_crowd(weak)
    set_weak(crowd, False)
    await crowd.start()
    await deploy(crowd, VISITORS)
    await go_on(crowd)
    set_weak(crowd, True)
    await deploy(crowd, VISITORS_2)
    began_ms = virtual_now_ms()
    await go_on(crowd)
    assert virtual_now_ms() - began_ms < CHANGE_MAX_MS
    assert status(crowd, 2) == "failed"
    assert [row.version for row in list_contracts(crowd.nodes["a"].executor.reader) if row.name == "visitors"] == [1]
    agree(crowd)
    set_weak(crowd, False)
    for node in crowd.nodes.values():
        node.executor.quarantine._changes.clear()  # ten minutes later
    await crowd.finalize("a", crowd.transaction("lifecycle", "propose", "activate", activation("visitors", 2)))
    await go_on(crowd)
    assert status(crowd, 2) == "active"
    agree(crowd)
    await crowd.stop()


@in_virtual_time
async def test_one_node_alone_cannot_fail_a_version_and_follows_with_more_effort() -> None:
    crowd = weak_crowd("c", needs=3)
    await crowd.start()
    await deploy(crowd, VISITORS)
    began_ms = virtual_now_ms()
    await go_on(crowd)
    assert virtual_now_ms() - began_ms < CHANGE_MAX_MS
    assert status(crowd, 1) == "active"
    assert machine(crowd, "c").tried
    assert crowd.nodes["c"].describe()["execution"]["stuck"] is None
    agree(crowd)
    await crowd.stop()


@in_virtual_time
async def test_a_version_fails_after_lost_turns_also_if_the_only_weak_node_is_needed_for_a_quorum() -> None:
    crowd = weak_crowd("c", needs=99)
    await crowd.start()
    await upload(crowd, VISITORS)
    crowd.cut_off = {"a"}
    await crowd.finalize("b", crowd.transaction("lifecycle", "propose", "deploy", deployment("visitors", VISITORS)))
    began_ms = virtual_now_ms()
    await go_on(crowd, "b", "c", "d")
    assert virtual_now_ms() - began_ms < 3 * CHANGE_MAX_MS
    assert status(crowd, 1, "b") == "failed"
    crowd.heal()
    await go_on(crowd)
    agree(crowd)
    await crowd.stop()


@pytest.mark.parametrize("weak", ["abcd", "ab", "bd", "c"])
@in_virtual_time
async def test_a_call_on_which_nodes_fail_stops_nothing(weak: str) -> None:
    crowd = weak_crowd(weak, needs=2)
    set_weak(crowd, False)
    await crowd.start()
    await deploy(crowd, VISITORS)
    await go_on(crowd)
    set_weak(crowd, True)
    deadly = [crowd.transaction("visitors", "enter", f"visitor {number}") for number in range(2)]
    for node in ("a", "c"):
        (told,) = await crowd.nodes[node].pool.submit([deadly.pop().wire])
        assert told.error is None
    for _ in range(3):
        began_ms = virtual_now_ms()
        await go_on(crowd)
        assert virtual_now_ms() - began_ms < CALL_MAX_MS
    agree(crowd)
    failures = [node.describe()["execution"]["failures"] for node in crowd.nodes.values()]
    assert any(failures)
    await crowd.stop()


@pytest.mark.parametrize("restarts", [False, True])
@in_virtual_time
async def test_a_node_that_cannot_execute_what_is_final_says_so_tries_again_and_catches_up(restarts: bool) -> None:
    crowd = weak_crowd("d", needs=99)
    set_weak(crowd, False)
    await crowd.start()
    await deploy(crowd, VISITORS)
    await go_on(crowd)
    set_weak(crowd, True)
    await crowd.finalize("a", crowd.transaction("visitors", "enter", "somebody"))
    await go_on(crowd, "a", "b", "c")
    await asyncio.sleep(5)
    lagging = crowd.nodes["d"]
    stuck = lagging.describe()["execution"]["stuck"]
    assert stuck["height"] == lagging.feed.height + 1
    assert stuck["attempts"] > 1
    assert lagging.core.halted == ""
    if restarts:
        await crowd.stop("d")
    for _ in range(50):
        await go_on(crowd, "a")
    assert lagging.feed.height < crowd.nodes["a"].feed.height - 40
    set_weak(crowd, False)  # the program, or what the machine has, was mended
    if restarts:
        await crowd.start("d")
    await crowd.wait_height(crowd.nodes["a"].feed.height, "d", timeout_s=90)
    await go_on(crowd)
    agree(crowd)
    await crowd.stop()


@in_virtual_time
async def test_all_nodes_halted_in_memory_go_on_after_a_restart_with_a_mended_program() -> None:
    """A version was approved that no node can put into force; the power goes before it is given up."""
    crowd = weak_crowd(NAMES)
    set_weak(crowd, False)
    await crowd.start()
    await deploy(crowd, VISITORS)
    await go_on(crowd)
    set_weak(crowd, True)
    await deploy(crowd, VISITORS_2)
    await crowd.stop()
    set_weak(crowd, False)
    await crowd.start()
    await go_on(crowd)
    assert status(crowd, 2) in ("active", "failed")
    agree(crowd)
    await crowd.stop()


@pytest.mark.parametrize("ahead", [1, 2, 3, 4])
@in_virtual_time
async def test_a_change_that_is_due_in_a_closing_block_waits_for_the_next_epoch(ahead: int) -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await upload(crowd, VISITORS)
    due = crowd.nodes["a"].feed.height + ahead + 4
    arguments = deployment("visitors", VISITORS, height=due)
    await crowd.finalize("a", crowd.transaction("lifecycle", "propose", "deploy", arguments))
    epoch = 0
    while crowd.nodes["a"].feed.height < due + 3:
        epoch += 1
        await crowd.finalize("a", crowd.transaction("settings", "propose", "heartbeat_ms", 3000 + epoch))
        await crowd.wait_epoch(epoch, timeout_s=10)
    for node in crowd.nodes.values():
        assert "visitors" in {row.name for row in list_contracts(node.executor.reader)}
    agree(crowd)
    await crowd.stop()
