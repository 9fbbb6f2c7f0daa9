"""Erasing against releasing on running nodes: owners download from both custodians all the while their records go."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import Counter

from clients.sdk.connections import NodeAddress
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import check_clip_download
from network.bench.custody.custody_clips import ClipRobot, SealedClip
from network.bench.fresh_network import FreshNetwork

FRAMES_COUNT, FRAME_BYTES, RECORDS_COUNT = 4, 20_000, 6
AT_ONCE_COUNT = 2
GONE = frozenset(("CLIP_ERASED", "ACCESS_NOT_GRANTED", "NOT_FOUND"))


class Downloads:
    """Downloads of one record from one custodian, one after another: when each began, and what came."""

    def __init__(self, robot: ClipRobot, clip: SealedClip, owner: PrivateKey, access_id: bytes) -> None:
        self._robot, self._clip, self._owner, self._access_id = robot, clip, owner, access_id
        self.whole_count = 0
        self.came: list[tuple[float, int]] = []
        self.refused: Counter[str] = Counter()

    async def go_on(self, node: NodeAddress, stopped: asyncio.Event) -> None:
        clip = self._clip
        while not stopped.is_set():
            began_s = time.monotonic()
            try:
                found = await self._robot.client.custody.download_clip(
                    node, clip.record_id, self._access_id, self._owner
                )
            except BlockRobotError as error:
                self.refused[error.code] += 1
                await asyncio.sleep(0.01)
                continue
            assert check_clip_download(found, clip.commitment_root, clip.ciphertext_root) == [], "a frame came torn"
            left = [frame for frame in found.frames if not frame.erased]
            assert all(frame.ciphertext and frame.sealed_key for frame in left)
            self.came.append((began_s, len(left)))
            self.whole_count += len(left) == FRAMES_COUNT


async def test_no_download_that_begins_after_the_receipts_brings_a_frame_and_none_comes_torn(
    stage: tuple[FreshNetwork, ClipRobot],
) -> None:
    _network, robot = stage
    whole_count, refused = 0, Counter[str]()
    for number in range(RECORDS_COUNT):
        owner = await robot.open_visit()
        clip = await robot.record(owner, FRAMES_COUNT, FRAME_BYTES)
        receipt = await robot.client.call(owner, "access", "request", [[clip.record_id], "demo"])
        downloads = Downloads(robot, clip, owner, receipt.txid)
        stopped = asyncio.Event()
        nodes = robot.client.custody.custodians
        assert len(nodes) == 2
        work = [asyncio.create_task(downloads.go_on(node, stopped)) for node in nodes for _ in range(AT_ONCE_COUNT)]
        await asyncio.sleep(secrets.randbelow(100) / 1000)
        frames = [] if number % 2 else [0, 2]
        erasure_id = await robot.request_erasure(owner, [clip.record_id], frames)
        await robot.wait_erased(owner, erasure_id)
        erased_s = time.monotonic()
        await asyncio.sleep(0.3)
        stopped.set()
        await asyncio.gather(*work)
        late = [count for began_s, count in downloads.came if began_s > erased_s]
        assert set(late) <= ({FRAMES_COUNT - len(frames)} if frames else {0}), "what is erased left again"
        whole_count += downloads.whole_count
        refused += downloads.refused
    assert whole_count > 0
    assert refused.keys() & GONE
