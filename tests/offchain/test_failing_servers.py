"""A MongoDB server that stands still, for a moment or for too long, or has no room left, in the middle of a block."""

from __future__ import annotations

import signal
import subprocess
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pymongo.errors import OperationFailure

from consensus.errors import BlockRobotError
from node.custody.stores.mongo_store import MongoStore
from tests.offchain import secantus
from tests.offchain.house import CustodianHarness, refused
from tests.offchain.small_chain import record_clip
from tests.offchain.test_every_write_point import Story

OUT_OF_DISK_SPACE = 14031
STEPS_MAX_COUNT = 100


@asynccontextmanager
async def _story_on_a_server(tmp_path: Path) -> AsyncIterator[tuple[Story, subprocess.Popen[bytes]]]:
    """An opened custodian over a server process of its own, which goes on and ends with the test."""
    storage, port = tmp_path / "server", secantus.choose_port()
    storage.mkdir()
    child = secantus.start(storage, port)
    uri = secantus.uri_of(port).replace("/?", "/custody?")
    try:
        house = CustodianHarness(lambda: MongoStore(uri), tmp_path / "erase-keys")
        async with house.open():
            yield Story(house), child
    finally:
        child.send_signal(signal.SIGCONT)
        secantus.stop(child)


def _at_the_fourth(act: Callable[[], None]) -> Callable[..., Any]:
    """Do something just before the fourth command that writes."""
    bulk, calls = MongoStore._bulk, []

    async def acted(store: MongoStore, name: str, operations: Any) -> None:
        calls.append(name)
        if len(calls) == 4:
            act()
        await bulk(store, name, operations)

    return acted


async def test_a_server_that_stands_still_for_a_moment_is_waited_for(
    tmp_path: Path, driver_sockets: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with _story_on_a_server(tmp_path) as (story, child):
        block = await story.prepare()
        release = threading.Timer(0.5, child.send_signal, [signal.SIGCONT])

        def stand_still() -> None:
            child.send_signal(signal.SIGSTOP)
            release.start()

        with monkeypatch.context() as patches:
            patches.setattr(MongoStore, "_bulk", _at_the_fourth(stand_still))
            await story.house.custodian.on_finalized_block(block)
        release.join()
        await story.check()


async def test_a_server_that_stands_still_for_too_long_stops_the_block_until_it_moves_again(
    tmp_path: Path, driver_sockets: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody waits for ever: the node's own work goes on, and the block is begun again."""
    for name in ("SOCKET_MAX_MS", "SERVER_SELECTION_MAX_MS"):
        monkeypatch.setattr(f"node.custody.stores.mongo_store.{name}", 400)
    async with _story_on_a_server(tmp_path) as (story, child):
        block, custodian = await story.prepare(), story.house.custodian
        with monkeypatch.context() as patches:
            patches.setattr(MongoStore, "_bulk", _at_the_fourth(lambda: child.send_signal(signal.SIGSTOP)))
            await refused("STORE_UNAVAILABLE", custodian.on_finalized_block(block))
            await refused("STORE_UNAVAILABLE", custodian.export(story.kept.record_id))
        child.send_signal(signal.SIGCONT)
        for attempt in range(STEPS_MAX_COUNT):
            try:
                await custodian.on_finalized_block(block)
                break
            except BlockRobotError as error:
                last = (error.code, attempt)
        else:
            pytest.fail(f"The server moves again, and the block is not followed: {last}")
        await custodian.on_finalized_block(block)
        await story.check()


async def test_a_server_without_room_stops_the_block_and_with_room_it_is_completed(
    tmp_path: Path, mongo_database: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MongoDB's own error, put in by hand at each command in turn: no server of the tests can be filled up."""
    left = [STEPS_MAX_COUNT]

    def needing_room(write: Callable[..., Any]) -> Callable[..., Any]:
        async def needs_room(store: MongoStore, name: str, given: Any) -> None:
            left[0] -= 1
            if left[0] < 0:
                # As the store itself does with whatever its server says.
                raise BlockRobotError("STORE_UNAVAILABLE") from OperationFailure("no space left", OUT_OF_DISK_SPACE)
            await write(store, name, given)

        return needs_room

    house = CustodianHarness(lambda: MongoStore(mongo_database), tmp_path / "erase-keys")
    async with house.open() as custodian:
        story = Story(house)
        block = await story.prepare()
        with monkeypatch.context() as patches:
            for name in ("_bulk", "_insert"):
                patches.setattr(MongoStore, name, needing_room(getattr(MongoStore, name)))
            for room in range(STEPS_MAX_COUNT):
                left[0] = room
                try:
                    await custodian.on_finalized_block(block)
                    break
                except BlockRobotError as error:
                    full = error.code
                await refused("STORE_UNAVAILABLE", custodian.stage(record_clip().upload))
        assert (full, room > 3) == ("STORE_UNAVAILABLE", True)
        await custodian.on_finalized_block(block)
    async with house.open():
        await story.check()
