"""Fetches missing and damaged clips from other custodians, sparing the disk's reserve."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from itertools import islice
from typing import TYPE_CHECKING, Protocol

import structlog

from consensus.errors import BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES
from consensus.records.clips import ClipDownload, FrameDownload, check_clip_download
from node.custody.block_effects import place
from node.custody.erase_keys import wrap_frames
from node.custody.many_at_once import for_each
from node.custody.stores.custody_store import BlockEffects, ClipRow, CustodyStore, RecordFacts

if TYPE_CHECKING:
    from consensus.records.placement import Placement
    from node.custody.erasure import Eraser

Keep = Callable[[Sequence[ClipDownload]], Awaitable[int]]
ReadFacts = Callable[[Sequence[bytes]], Mapping[bytes, RecordFacts]]
"""Those of these records that the chain keeps now, with all frames of them that it wants erased."""

FETCH_AT_ONCE_COUNT = 1_024
"""Between two of these rounds nothing is under way."""
FETCHES_IN_FLIGHT_COUNT = 4
PEER_FAILURES_MAX_COUNT = 3
"""Of one round; who has failed so often, is slow or lies, is asked again in the next."""
INSTALLS_IN_FLIGHT_COUNT = 2
"""For one of them keys are made, while the one before it is written."""
INSTALL_AT_ONCE_MAX_BYTES = 3 * 1024 * 1024
"""With the clip that comes last, what a database takes as one transaction."""
PLACED_AT_ONCE_COUNT = 256
_ROOM_BYTES = (FETCHES_IN_FLIGHT_COUNT + INSTALLS_IN_FLIGHT_COUNT) * (INSTALL_AT_ONCE_MAX_BYTES + CLIP_SIZE_MAX_BYTES)

log = structlog.get_logger(__name__)


class PeerCustodian(Protocol):
    """A custodian of another node, with its chain key, asked for clips."""

    @property
    def name(self) -> str: ...

    @property
    def member(self) -> bytes: ...

    async def fetch(self, record_id: bytes) -> ClipDownload | None: ...


InTurn = Callable[[bytes], list[PeerCustodian]]
"""Whom to ask for a record, the likeliest first."""


def check_fetched(fetched: ClipDownload, facts: RecordFacts) -> None:
    """Raises PROOF_INVALID (leaves against chain roots), UPLOAD_HASH_MISMATCH (bytes against leaves), UPLOAD_INVALID."""
    damaged = check_clip_download(fetched, facts.commitment_root, facts.ciphertext_root)
    if damaged:
        raise BlockRobotError("UPLOAD_HASH_MISMATCH", f"Frames {damaged} of the fetched clip are damaged.")


def _is_whole(fetched: ClipDownload, facts: RecordFacts) -> bool:
    return not any(frame.erased and frame.index not in facts.erased_frames for frame in fetched.frames)


def parts_of(frames: Sequence[FrameDownload]) -> list[tuple[int, bytes, bytes]]:
    return [(frame.index, frame.ciphertext, frame.sealed_key) for frame in frames]


class ClipFetcher:
    """Mixin of `Custodian` that fetches clips. `passes_count`: how often all missing ones were asked for."""

    passes_count = 0
    _asked_range: tuple[tuple[int, bytes], tuple[int, bytes]] | None = None

    if TYPE_CHECKING:  # the custodian's own
        _store: CustodyStore
        _eraser: Eraser
        _has_room: Callable[[int], bool]
        _waited_s: dict[str, float]
        _member: bytes
        _writing: asyncio.Lock
        _placed_by: Placement | None
        _placed_up_to: bytes | None
        _find_placement: Callable[[], Placement]

        async def _settle_missing(self, missing: Sequence[RecordFacts]) -> None: ...

        async def install_checked(self, fetched: Sequence[ClipDownload]) -> int: ...

        def _taking(self, count: int) -> AbstractAsyncContextManager[list[tuple[int, bytes]]]: ...

    async def follow_placement(self) -> int:
        """After custodians or the number of copies changed: sort what is not here into missing and kept elsewhere.

        What is here stays, whoever is to keep it. Returns how many changed. It ends early where they change once more: cut
        off, it is done again, and clips are fetched in between.
        """
        count = 0
        async with self._writing:
            begun = self._newest_placement()
        while self._placed_up_to is not None:
            async with self._writing:
                placement, after = self._newest_placement(), self._placed_up_to or b""
                if placement != begun:
                    break
                absent = await self._store.absent(after, PLACED_AT_ONCE_COUNT)
                clips = await self._store.clips([facts.record_id for facts in absent])
                await self._settle_missing([facts for facts in absent if facts.record_id in clips])
                left = [facts for facts in absent if facts.record_id not in clips]
                moved = [now for facts in left if (now := place(facts, self._member, placement)) != facts]
                await self._store.apply(BlockEffects(missing=tuple(moved)))
                self._placed_up_to = absent[-1].record_id if absent else None
            count += len(moved)
        return count

    def _newest_placement(self) -> Placement:
        """While writing only. Where it is another than before, whatever is absent is to be sorted again, also if it is soon
        the old one again: what came meanwhile was sorted otherwise.
        """
        placement = self._find_placement()
        if placement != self._placed_by:
            self._placed_by, self._placed_up_to = placement, b""
        return placement

    async def fetch_missing(self, peers: Sequence[PeerCustodian]) -> int:
        """Fetch up to 1,024 missing clips, newest first, in turns; return those installed."""
        return await self._fetch_each(await self._choose_missing(), peers, self.install_checked)

    async def mend(
        self, damaged: Sequence[RecordFacts], peers: Sequence[PeerCustodian], read_facts: ReadFacts
    ) -> set[bytes]:
        """Fetch sound copies of damaged confirmed clips, as missing ones are fetched; return what was mended."""
        mended: set[bytes] = set()

        async def keep(fetched: Sequence[ClipDownload]) -> int:
            replaced = await self.repair_clips(fetched, read_facts)
            mended.update(replaced)
            return len(replaced)

        await self._fetch_each(damaged, peers, keep)
        return mended

    async def repair_clips(self, fetched: Sequence[ClipDownload], read_facts: ReadFacts) -> list[bytes]:
        """Replace damaged confirmed clips by other custodians' whole copies; return those that were replaced.

        Old keys go after new rows exist. The caller checked the copies against the chain's roots.
        """
        replaced, unused = list[bytes](), list[int]()
        async with self._taking(sum(len(clip.frames) for clip in fetched)) as taken, self._writing:
            left = iter(taken)
            given = {clip.record_id: list(islice(left, len(clip.frames))) for clip in fetched}
            facts, clips = read_facts(list(given)), await self._store.clips(list(given))

            async def replace(copy: ClipDownload) -> None:
                key, own = copy.record_id, given[copy.record_id]
                over = await self._repair_under(copy, facts.get(key), clips.get(key), own)
                unused.extend(over)
                if not {slot for slot, _ in own} <= set(over):
                    replaced.append(key)

            await for_each(fetched, replace)
            await self._eraser.destroy_unused(unused)
        return replaced

    async def _repair_under(
        self, fetched: ClipDownload, facts: RecordFacts | None, clip: ClipRow | None, taken: Sequence[tuple[int, bytes]]
    ) -> list[int]:
        """Return the slots of which nobody needs the keys any more."""
        slots = [slot for slot, _ in taken]
        if facts is None or clip is None or clip.status != "confirmed" or not _is_whole(fetched, facts):
            return slots
        present = [frame for frame in fetched.frames if frame.index not in facts.erased_frames]
        old = [place.slot for place in await self._store.frame_places([clip.record_id])]
        rows = wrap_frames(clip.record_id, parts_of(present), taken[: len(present)])
        await self._store.replace_frames(clip.record_id, rows)
        return [*old, *slots[len(present) :]]

    async def _fetch_each(self, wanted: Sequence[RecordFacts], peers: Sequence[PeerCustodian], keep: Keep) -> int:
        """Return how many were kept. Copies that lack a frame which is not erased are passed over.

        Keepers are asked first, of these who answered fastest, and nobody who has failed three times. While some are
        fetched, those before them are stored, many at once.
        """
        due, fetched, failures = iter(wanted), list[ClipDownload](), Counter[str]()
        installs, turns = list[asyncio.Task[int]](), asyncio.Semaphore(INSTALLS_IN_FLIGHT_COUNT)
        placement = self._find_placement()

        def in_turn(record_id: bytes) -> list[PeerCustodian]:
            keepers = placement.keepers(record_id)
            asked = [peer for peer in peers if failures[peer.name] < PEER_FAILURES_MAX_COUNT]
            return sorted(asked, key=lambda peer: (peer.member not in keepers, self._waited_s.get(peer.name, 0.0)))

        async def install(batch: Sequence[ClipDownload]) -> int:
            try:
                return await keep(batch)
            finally:
                turns.release()

        async def fetch() -> None:
            async for batch in self._fetch_in_turn(due, in_turn, fetched, failures):
                await turns.acquire()
                installs.append(group.create_task(install(batch)))

        try:
            async with asyncio.TaskGroup() as group:
                for _ in range(FETCHES_IN_FLIGHT_COUNT):
                    group.create_task(fetch())
        except BaseExceptionGroup as errors:
            raise errors.exceptions[0] from None
        return sum(work.result() for work in installs) + (await keep(fetched) if fetched else 0)

    async def _fetch_in_turn(
        self, due: Iterator[RecordFacts], in_turn: InTurn, fetched: list[ClipDownload], failures: Counter[str]
    ) -> AsyncIterator[list[ClipDownload]]:
        """Batches to be installed; the last ones, too few for one, stay in `fetched`."""
        for facts in due:
            if not self._has_room(_ROOM_BYTES):
                log.warning("clips_not_fetched", code="DISK_RESERVE_REACHED")
                break
            if clip := await self._fetch_from_any(facts, in_turn(facts.record_id), failures):
                fetched.append(clip)
            if sum(len(frame.ciphertext) for clip in fetched for frame in clip.frames) >= INSTALL_AT_ONCE_MAX_BYTES:
                batch, fetched[:] = fetched[:], []
                yield batch

    async def _fetch_from_any(
        self, facts: RecordFacts, peers: Sequence[PeerCustodian], failures: Counter[str]
    ) -> ClipDownload | None:
        for peer in peers:
            try:
                fetched = await self._fetch_checked(peer, facts)
            except BlockRobotError as error:
                log.info("custody_fetch_refused", peer=peer.name, code=error.code)
                self._waited_s[peer.name] = math.inf
                failures[peer.name] += 1
                continue
            if fetched is not None:
                return fetched
        return None

    async def _fetch_checked(self, peer: PeerCustodian, facts: RecordFacts) -> ClipDownload | None:
        """None if this peer has no whole copy. Raises as `check_fetched`, and what the peer's answer comes to."""
        now_s = asyncio.get_running_loop().time
        begun_s = now_s()
        fetched = await peer.fetch(facts.record_id)
        if fetched is not None:
            if fetched.record_id != facts.record_id:
                raise BlockRobotError("PEER_MESSAGE_INVALID", "The peer sent another record's clip.")
            check_fetched(fetched, facts)
        self._waited_s[peer.name] = now_s() - begun_s
        if fetched is not None and not _is_whole(fetched, facts):
            log.info("custody_copy_not_whole", peer=peer.name)
            self._waited_s[peer.name] = math.inf
            return None
        return fetched

    async def _choose_missing(self) -> list[RecordFacts]:
        """The newest that were not asked for in this pass, which goes on to the oldest, however many of them nobody has.

        Those that came meanwhile are first; in the end all are asked for again.
        """
        newest = await self._store.missing(FETCH_AT_ONCE_COUNT)
        first, last = self._asked_range or (None, None)
        chosen = [facts for facts in newest if first is None or last is None or not first <= _position(facts) <= last]
        if len(chosen) < len(newest) == FETCH_AT_ONCE_COUNT:
            after = max(_position(newest[-1]), last or _position(newest[-1]))
            chosen += await self._store.missing(FETCH_AT_ONCE_COUNT - len(chosen), (-after[0], after[1]))
        if not chosen:
            self.passes_count += 1
            self._asked_range, chosen = None, newest
        positions = [*(self._asked_range or ()), *map(_position, chosen)]
        if positions:
            self._asked_range = min(positions), max(positions)
        return chosen


def _position(facts: RecordFacts) -> tuple[int, bytes]:
    """In the order in which stores list what is missing."""
    return -facts.height, facts.record_id
