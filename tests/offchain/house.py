"""A custodian with its store and its erase keys, as tests open, crash and open it again."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.records.clips import ClipDownload, check_clip_download
from consensus.records.envelopes import open_data_key, open_frame
from consensus.records.placement import Placement
from node.custody.custodian import Custodian
from node.custody.erase_keys import EraseKeys
from node.custody.stores.custody_store import CustodyStore
from tests.offchain.small_chain import (
    ALICE,
    CUSTODIAN,
    RecordedClip,
    SmallChain,
    record_clip,
    recorded,
)

ACCESS_ID, ERASURE_ID = b"\xa1" * 32, b"\xe1" * 32


class CustodianHarness:
    """A custodian with its store and its erase keys, which can be closed and opened again."""

    def __init__(self, make_store: Callable[[], CustodyStore], directory: Path) -> None:
        self.make_store = make_store
        self.directory = directory
        self.chain = SmallChain()
        self.has_room = True
        self.approved_frames: set[bytes] = set()
        self.placement = Placement.even([CUSTODIAN], 0)
        self.store: CustodyStore
        self.keys: EraseKeys
        self.custodian: Custodian

    @asynccontextmanager
    async def open(self) -> AsyncIterator[Custodian]:
        with EraseKeys(self.directory) as self.keys:
            async with self.make_store() as self.store:
                clock = lambda: self.chain.time_ms  # noqa: E731
                room = lambda _size_bytes: self.has_room  # noqa: E731
                self.custodian = Custodian(
                    self.store,
                    self.keys,
                    member=CUSTODIAN,
                    clock_ms=clock,
                    has_room=room,
                    is_frame_approved=lambda digest: digest in self.approved_frames,
                    find_placement=lambda: self.placement,
                )
                await self.custodian.start()
                yield self.custodian

    async def follow(self, *events: tuple, at_ms: int | None = None) -> None:
        await self.custodian.on_finalized_block(self.chain.block(*events, at_ms=at_ms))

    async def keep(self, clip: RecordedClip | None = None, owner: bytes = ALICE) -> RecordedClip:
        """Upload a clip, a new one unless it is given, and let its record become final."""
        clip = clip or record_clip()
        await self.custodian.stage(clip.upload)
        await self.follow(recorded(clip, owner))
        return clip

    async def ready_outbox(self) -> list[tuple[str, list]]:
        return [
            (f"{row.contract}.{row.entry}", decode_value(row.arguments))
            for row in await self.custodian.ready_outbox(100)
        ]


async def refused(code: str, action) -> None:
    with pytest.raises(BlockRobotError, match=rf"^{code}:"):
        await action


def read_all(clip: RecordedClip, download: ClipDownload) -> list[bytes | None]:
    """Open every frame as the owner's wallet does; None for an erased one."""
    data = recorded(clip)[2]
    assert check_clip_download(download, data["commitment_root"], data["ciphertext_root"]) == []
    return [
        None
        if frame.erased
        else open_frame(open_data_key(bytes(clip.sealing), frame.sealed_key), clip.record_id, index, frame.ciphertext)
        for index, frame in enumerate(download.frames)
    ]
