"""Backups put back by an attacker, who asks for what was erased from the first moment on, with a request of before.

Whoever has a custodian's machine has its bytes: what is tried here is whether the network can be made to hand them out.
"""

from __future__ import annotations

import asyncio
import shutil
from collections import Counter
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pymongo import MongoClient

from clients.sdk.connections import NodeAddress
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from network.bench.custody.custody_clips import ClipRobot, SealedClip
from network.bench.fresh_network import FreshNetwork
from network.custody.custody_requests import run_work
from node.config import NodeConfig
from node.custody.coordination.custody_answers import ScrubAnswer
from tests.cluster.test_custody_upkeep import _settled

FRAMES_COUNT, FRAME_BYTES = 3, 6_000
KINDS = ("store", "keys", "store and keys", "everything")


class OldMachine:
    """A copy of a stopped custodian: its folder, and its database if that is elsewhere."""

    def __init__(self, config: NodeConfig, place: Path) -> None:
        self._config, self._place = config, place
        shutil.copytree(config.data_dir, place)
        self._documents: dict[str, list[dict[str, Any]]] = {}
        self._uri = config.custody_store if config.custody_store.startswith("mongodb") else ""
        if self._uri:
            with MongoClient(self._uri) as client:
                database = client[urlsplit(self._uri).path.lstrip("/")]
                self._documents = {name: list(database[name].find()) for name in database.list_collection_names()}

    def restore(self, kind: str) -> None:
        """Put back a part of it beside what is there now."""
        config = self._config
        folders = {"store": [config.custody_dir], "keys": [config.erase_keys_dir], "everything": [config.data_dir]}
        folders["store and keys"] = [*folders["store"], *folders["keys"]]
        for folder in folders[kind]:
            old = self._place / folder.relative_to(config.data_dir)
            if old.exists():
                shutil.rmtree(folder, ignore_errors=True)
                shutil.copytree(old, folder)
        if self._uri and kind != "keys":
            with MongoClient(self._uri) as client:
                database = client[urlsplit(self._uri).path.lstrip("/")]
                for name, documents in self._documents.items():
                    database[name].delete_many({})
                    if documents:
                        database[name].insert_many(documents)


async def _ask_on_and_on(
    robot: ClipRobot, node: NodeAddress, clip: SealedClip, access_id: bytes, owner: PrivateKey, stopped: asyncio.Event
) -> tuple[int, Counter[str]]:
    """Ask one custodian for a clip again and again; return how many frames came, and the refusals."""
    came, refused = 0, Counter[str]()
    while not stopped.is_set():
        try:
            found = await robot.client.custody.download_clip(node, clip.record_id, access_id, owner)
            came += sum(not frame.erased for frame in found.frames)
        except BlockRobotError as error:
            refused[error.code] += 1
        await asyncio.sleep(0.02)
    return came, refused


async def test_what_was_erased_is_not_handed_out_whatever_was_put_back(
    stage: tuple[FreshNetwork, ClipRobot], tmp_path: Path
) -> None:
    network, robot = stage
    cluster = network.cluster
    victim = cluster.genesis.custodians[0].name
    owner = await robot.open_visit()
    gone, kept = [await robot.record(owner, FRAMES_COUNT, FRAME_BYTES) for _ in range(2)]
    asked = await robot.client.call(owner, "access", "request", [[gone.record_id, kept.record_id], "demo"])
    await _settled(cluster)
    (node,) = [node for node in robot.client.custody.custodians if node.name == victim]
    assert (await robot.client.custody.download_clip(node, gone.record_id, asked.txid, owner)).frames[0].ciphertext
    await asyncio.to_thread(cluster.stop, victim)
    backup = await asyncio.to_thread(OldMachine, cluster.config(victim), tmp_path / "backup")
    cluster.start(victim)
    await cluster.wait_ready([victim])
    await robot.wait_erased(owner, await robot.request_erasure(owner, [gone.record_id]))
    for kind in KINDS:
        await asyncio.to_thread(cluster.stop, victim)
        await asyncio.to_thread(backup.restore, kind)
        stopped = asyncio.Event()
        asking = asyncio.create_task(_ask_on_and_on(robot, node, gone, asked.txid, owner, stopped))
        cluster.start(victim)
        await cluster.wait_answering(victim)
        await _settled(cluster)
        stopped.set()
        came, refused = await asking
        assert came == 0, (kind, refused)
        assert refused["CLIP_ERASED"] or refused["ACCESS_NOT_GRANTED"] or refused["NOT_FOUND"], (kind, refused)
        report = await run_work(cluster.config(victim), ScrubAnswer, lambda *_: None)
        assert report.nothing_erased_is_left, (kind, report)
        found = await robot.client.custody.download_clip(node, kept.record_id, asked.txid, owner)
        assert [frame.erased for frame in found.frames] == [False] * FRAMES_COUNT, kind
