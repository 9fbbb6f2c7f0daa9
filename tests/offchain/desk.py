"""An opened custodian beside a state of the chain that a test puts together, to scrub it and to make its index again."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

from consensus.records.clips import ClipDownload, FrameDownload
from node.custody.chain_facts import ChainFacts
from node.custody.repair.rebuild import Rebuild, RebuildReport
from node.custody.repair.scrub import ScrubReport, Tell, ignore_progress, scrub
from tests.offchain.house import CustodianHarness, read_all
from tests.offchain.small_chain import RecordedClip
from tests.offchain.small_state import State


class Peer:
    """Another custodian, with the clips that the test gives it."""

    name, member = "node-2", b""

    def __init__(self, *clips: RecordedClip, erased: tuple[int, ...] = ()) -> None:
        self.clips = {clip.record_id: clip for clip in clips}
        self.erased = erased

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        clip = self.clips.get(record_id)
        if clip is None:
            return None
        frames = []
        for index, (text, key) in enumerate(zip(clip.upload.ciphertexts, clip.upload.sealed_keys, strict=True)):
            gone = index in self.erased
            frames.append([index, gone, b"" if gone else text, b"" if gone else key])
        return ClipDownload(
            record_id=record_id,
            txid=clip.upload.txid,
            frames=[FrameDownload(index=i, erased=e, ciphertext=c, sealed_key=k) for i, e, c, k in frames],
            commitment_leaves=list(clip.upload.commitment_leaves),
            ciphertext_leaves=list(clip.leaves),
        )


class CustodyHarness:
    """An opened house beside a state of the chain that the test puts together."""

    def __init__(self, house: CustodianHarness) -> None:
        self.house, self.state = house, State()

    async def hold(self, *clips: RecordedClip) -> None:
        """Let the custodian keep clips, and let the state know them in the same words."""
        for clip in clips:
            await self.house.keep(clip)
            self.record(clip)

    def record(self, clip: RecordedClip, **changes: object) -> None:
        known = {"height": self.house.chain.height, "txid": clip.upload.txid}
        self.state.record(clip, **{**known, **changes})

    def open_facts(self) -> Callable[[], AbstractContextManager[ChainFacts]]:
        return lambda: self.state.open(self.house.chain.height, self.house.chain.time_ms)

    async def scrub(self, tell: Tell = ignore_progress, *, after: bytes = b"") -> ScrubReport:
        house = self.house
        return await scrub(house.custodian, house.store, house.keys, self.open_facts(), tell, after)

    async def rebuild(self, *peers: Peer) -> RebuildReport:
        async def pause() -> None:
            """Nobody new comes."""

        house = self.house
        parts = (house.custodian, house.store, house.keys, self.open_facts(), lambda: peers)
        return await Rebuild(*parts, pause=pause).run()

    async def opens(self, clip: RecordedClip) -> bool:
        return read_all(clip, await self.house.custodian.export(clip.record_id)) == list(clip.plaintexts)
