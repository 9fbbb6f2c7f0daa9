"""Shares at one custodian: key parts, of clips kept elsewhere too, kept wrapped while their grants stand.

They are destroyed, erase key before row, on revocation, end, erasure or denial.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.encoding import Wire, decode, encode
from consensus.records.sharing import GrantUpload, KeyPart
from node.custody.erase_keys import ErasableKeys, unwrap_key, wrap_key
from node.custody.erasure import Eraser
from node.custody.restrictions import find_restrictions
from node.custody.stores.custody_store import ClipRow, CustodyStore, Grant, RecordFacts
from node.custody.stores.share_store import PartPlace, PartRow, ShareRow
from node.process_memory import wipe

PARTS_STAGED_MAX_COUNT = 1024
"""How many parts of grants that are not final yet one visit may have here."""
PARTS_AT_ONCE_COUNT = 64
CLOCK_SLACK_MS = 60_000
"""How much further ahead an upload's expiry may be than any transaction's, since clocks differ."""
PART_PLACE = 0xFFFF_FFFF
"""Where a frame would have its index: a wrapped part is no frame's key."""


class HeldPart(Wire, frozen=True):
    """What is wrapped in a part's row."""

    grant_id: bytes
    package: bytes
    parts: list[KeyPart]


@dataclass(frozen=True, slots=True)
class CheckedPart:
    """A judged upload: the new row without slot and bytes, or the known one."""

    row: PartRow
    is_known: bool


def grant_covers(grant: Grant, clip: ClipRow | RecordFacts) -> bool:
    if grant.owner != clip.owner:
        return False
    return clip.record_id in grant.records if grant.records else clip.height <= grant.height


async def find_record(store: CustodyStore, record_id: bytes) -> ClipRow | RecordFacts | None:
    """Return a final record's clip, or what is known of one that is not here. Raises CLIP_ERASED."""
    clip = (await store.clips([record_id])).get(record_id)
    if clip is not None and clip.status == "erased":
        raise BlockRobotError("CLIP_ERASED")
    if clip is not None and clip.status == "confirmed":
        return clip
    return (await store.missing_clips([record_id])).get(record_id)


async def may_release(store: CustodyStore, grant: Grant, record_id: bytes) -> bool:
    return not grant.share or await store.part(grant.share, record_id) is not None


class Shares:
    """One custodian's shares; writers hold the custodian's lock and call `finish` later."""

    def __init__(self, store: CustodyStore, eraser: Eraser, keys: ErasableKeys) -> None:
        self._store = store
        self._eraser = eraser
        self._keys = keys

    # Uploads

    async def check_part(self, upload: GrantUpload, owner: bytes, now_ms: int) -> CheckedPart:
        """`owner`: the visit's (33 bytes).

        Raises CLIP_NOT_CONFIRMED, CLIP_ERASED, CLIP_QUARANTINED, NOT_PERMITTED, GRANT_ENDED, TRANSACTION_EXPIRED,
        UPLOAD_INVALID, UPLOAD_CONFLICT, RATE_LIMITED.
        """
        await self._check_record(upload.record_id, owner)
        known = await self._store.part(upload.grant_txid, upload.record_id)
        held = None if known is None else self._unwrap(known)
        if held is not None and held != HeldPart(upload.grant_txid, upload.package, upload.parts):
            raise BlockRobotError("UPLOAD_CONFLICT")
        row = await self._place(upload, owner, now_ms)
        if known is not None and held is not None:
            until_ms = max(known.valid_until_ms, row.valid_until_ms)
            return CheckedPart(
                replace(row, valid_until_ms=until_ms, slot=known.slot, wrapped=known.wrapped), is_known=True
            )
        return CheckedPart(row, is_known=False)

    async def _check_record(self, record_id: bytes, owner: bytes) -> None:
        record = await find_record(self._store, record_id)
        if record is None:
            raise BlockRobotError("CLIP_NOT_CONFIRMED", "This custodian does not know the record yet.")
        if record.owner != owner:
            raise BlockRobotError("NOT_PERMITTED", "The record belongs to another owner key.")
        restrictions = await find_restrictions(self._store, owner)
        if restrictions is not None and restrictions.quarantined:
            raise BlockRobotError("CLIP_QUARANTINED")

    async def _place(self, upload: GrantUpload, owner: bytes, now_ms: int) -> PartRow:
        point, share = await self._store.checkpoint(), await self._store.share(upload.grant_txid)
        at_ms = 0 if point is None else point.timestamp_ms
        now_ms = max(now_ms, at_ms)  # a clock that is behind the chain is wrong; nobody's upload is refused for it
        staged = PartRow(upload.grant_txid, upload.record_id, owner, upload.valid_until_ms, "staged", 0, -1, b"")
        if share is not None:
            if share.owner != owner or upload.record_id not in share.records:
                raise BlockRobotError(
                    "NOT_PERMITTED",
                    "The grant is another visit's, does not name this record, or frames of it were erased since: "
                    "share it again.",
                )
            if share.until_ms <= now_ms:
                raise BlockRobotError("GRANT_ENDED")
            return replace(staged, status="confirmed", height=share.height)
        if upload.valid_until_ms > now_ms + TRANSACTION_LIFETIME_MAX_MS + CLOCK_SLACK_MS:
            raise BlockRobotError("UPLOAD_INVALID", "The transaction's expiry is more than ten minutes ahead.")
        if upload.valid_until_ms <= at_ms:
            raise BlockRobotError("TRANSACTION_EXPIRED", "The grant can no longer become final, or has ended.")
        waiting = [place for place in await self._store.parts_of("owner", [owner]) if place.status == "staged"]
        if len(waiting) >= PARTS_STAGED_MAX_COUNT:
            raise BlockRobotError("RATE_LIMITED", "Too many shares of this visit wait for their grants here.")
        return staged

    async def put(self, judged: CheckedPart, upload: GrantUpload, taken: tuple[int, bytes] | None) -> None:
        """Store a judged upload under a slot's erase key; known parts keep theirs."""
        row = judged.row
        if not judged.is_known:
            if taken is None:
                raise BlockRobotError("STORE_UNAVAILABLE", "The part went while it was brought again.")
            slot, erase_key = taken
            content = encode(HeldPart(upload.grant_txid, upload.package, upload.parts))
            row = replace(row, slot=slot, wrapped=wrap_key(erase_key, upload.record_id, PART_PLACE, content))
            wipe(erase_key)
        await self._store.put_part(row)

    # Release

    async def require_open_grant(self, grant_id: bytes, now_ms: int) -> None:
        """Raise GRANT_ENDED unless a grant stands, by blocks and clock."""
        share = await self._store.share(grant_id)
        if share is None or share.until_ms <= now_ms:
            raise BlockRobotError("GRANT_ENDED")

    def open(self, row: PartRow | None) -> HeldPart:
        """With its present erase key. Raises GRANT_PARTS_MISSING."""
        held = None if row is None or row.status != "confirmed" else self._unwrap(row)
        if held is None:
            raise BlockRobotError("GRANT_PARTS_MISSING", "This custodian has no part of the key of this record.")
        return held

    def _unwrap(self, row: PartRow) -> HeldPart | None:
        erase_key = self._keys.read(row.slot)
        if erase_key is None:
            return None
        try:
            held = decode(unwrap_key(erase_key, row.record_id, PART_PLACE, row.wrapped), HeldPart)
        except BlockRobotError:
            return None  # of another slot's time: a store put back beside the keys of today
        finally:
            wipe(erase_key)
        return held if held.grant_id == row.grant_id else None

    # What the chain says

    async def take_grant(self, share: ShareRow) -> None:
        """Confirm a final grant's parts; destroy uploads that do not belong to it."""
        await self._store.put_share(share)
        places = await self._store.parts_of("grant_id", [share.grant_id])
        own = [place for place in places if place.owner == share.owner and place.record_id in share.records]
        await self._eraser.destroy_parts([place for place in places if place not in own])
        await self._store.confirm_parts(share.grant_id, [place.record_id for place in own], share.height)

    async def leave_out(self, owner: bytes, record_ids: Sequence[bytes], height: int) -> None:
        """Exclude records with erased frames from grants up to this height."""
        gone = set(record_ids)
        for share in await self._store.shares_of(owner):
            if share.height <= height and gone & set(share.records):
                left = tuple(record_id for record_id in share.records if record_id not in gone)
                await self._store.put_share(replace(share, records=left))

    async def end_grant(self, grant_id: bytes) -> None:
        await self._eraser.destroy_parts(await self._store.parts_of("grant_id", [grant_id]))
        await self._store.forget_share(grant_id)

    async def deny_visit(self, owner: bytes) -> None:
        await self._eraser.destroy_parts(await self._store.parts_of("owner", [owner]))

    async def is_any_over(self, at_ms: int) -> bool:
        """Whether `close_block` would destroy anything."""
        return bool(await self._store.lapsed_parts(at_ms, 1) or await self._store.shares_over(at_ms, 1))

    async def close_block(self, at_ms: int) -> None:
        """Destroy parts of grants ended or never finalized by a block's time."""
        while lapsed := await self._store.lapsed_parts(at_ms, PARTS_AT_ONCE_COUNT):
            await self._eraser.destroy_parts(lapsed)
        while over := await self._store.shares_over(at_ms, PARTS_AT_ONCE_COUNT):
            for grant_id in over:
                await self.end_grant(grant_id)

    async def reconcile(
        self,
        standing: Mapping[bytes, ShareRow],
        is_over: Iterable[bytes],
        denied: set[bytes],
        denied_meanwhile: Mapping[bytes, int],
    ) -> None:
        """Reconcile shares with a state: standing grants, ended ids, denied visits.

        `denied_meanwhile`: heights of denials in skipped blocks; parts of grants up to them go, even if since settled.
        """
        ended = set(is_over)
        for grant_id in [share.grant_id async for share in self._store.all_shares() if share.grant_id not in standing]:
            await self.end_grant(grant_id)
        wrong: list[PartPlace] = []
        async for place in self._store.all_parts():
            was_final = place.status == "confirmed" or place.grant_id in ended
            share = standing.get(place.grant_id)
            height = place.height if share is None else share.height
            was_denied = place.owner in denied or height <= denied_meanwhile.get(place.owner, -1)
            if was_denied or (was_final and share is None):
                wrong.append(place)
        await self._eraser.destroy_parts(wrong)
        for share in standing.values():
            await self.take_grant(share)
