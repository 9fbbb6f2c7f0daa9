"""Two-officer erasure by robot and span, after an owner's key loss.

Spans may touch others' visits: a proven preview comes first. Steps are signed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from clients.sdk.chain.announcements import Announcement
from clients.sdk.chain.proved_rows import proved_list, proved_row, proved_rows
from clients.sdk.chain.receipts import FinalReceipt
from clients.wallet.ledger.id_prefix import PROPOSAL, resolve_id_prefix
from clients.wallet.ledger.visit_audit import RECORDED_KIND
from clients.wallet.ledger.wallet import Wallet
from consensus.errors import BlockRobotError
from consensus.limits import RECORDS_A_CALL_MAX_COUNT, TIME_BUCKET_MS
from consensus.rights.right_codes import LOST_KEY_SPAN_MAX_MS
from consensus.state import officers
from consensus.state.audit import COUNT, ENTRY, entry_keys
from consensus.state.officers import ProposalRow
from consensus.state.records import RECORD
from consensus.state.rights import QUARANTINE, RESTRICTION

ID_PREFIX_MIN_CHARS = 8
_HALVING_PAGE_COUNT = 8
LATE_MAX_MS = 24 * 3600 * 1000 + 2 * TIME_BUCKET_MS
"""How much later than its bucket a visit may come to the chain: a robot's spool outlasts a day's cut of the network."""
_KEPT_MEANWHILE = frozenset({"RECORD_RESTRICTED", "VISIT_QUARANTINED", "RECORD_ERASED"})
OnProgress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Span:
    """A robot's key and a half-open span in ms, in whole buckets."""

    robot: bytes
    from_ms: int
    until_ms: int


@dataclass(frozen=True, slots=True)
class SpanVisit:
    """A visit in a span: records to erase, restriction, and denial."""

    owner: bytes
    bucket_ms: int
    erasable: tuple[bytes, ...]
    restricted_count: int = 0
    denied: bool = False


@dataclass(frozen=True, slots=True)
class Preview:
    """A span's proven erasure preview."""

    span: Span
    visits: tuple[SpanVisit, ...]

    @property
    def touched(self) -> tuple[SpanVisit, ...]:
        return tuple(visit for visit in self.visits if visit.erasable)

    @property
    def records_count(self) -> int:
        return sum(len(visit.erasable) for visit in self.visits)


@dataclass(frozen=True, slots=True)
class Proposal:
    """A proposal proven at block time `now_ms`; `state` is the contract's row."""

    proposal_id: bytes
    state: ProposalRow
    now_ms: int
    is_own: bool = False
    """Whether it is the proposal of the officer who reads it."""

    @property
    def span(self) -> Span:
        return Span(self.state.robot, self.state.from_ms, self.state.until_ms)

    @property
    def status(self) -> str:
        """Proposed, approved, stopped, or lapsed."""
        is_over = self.state.status != "stopped" and self.now_ms > self.state.ends_ms
        return "lapsed" if is_over else self.state.status

    @property
    def is_open(self) -> bool:
        return self.status in {"proposed", "approved"}


@dataclass(frozen=True, slots=True)
class OrderedErasures:
    """Ordered erasure ids; number of visits left, by cause."""

    erasure_ids: tuple[bytes, ...]
    visits: int
    records: int
    kept_visits: int
    left_visits: int


def make_span(robot: bytes, from_ms: int, until_ms: int) -> Span:
    """Return the enclosing buckets. Raises SPAN_INVALID."""
    first = from_ms - from_ms % TIME_BUCKET_MS
    end = -(-until_ms // TIME_BUCKET_MS) * TIME_BUCKET_MS
    if not 0 <= first < end:
        raise BlockRobotError("SPAN_INVALID", "The span ends before it begins.")
    if end - first > LOST_KEY_SPAN_MAX_MS:
        minutes = LOST_KEY_SPAN_MAX_MS // 60_000
        raise BlockRobotError(
            "SPAN_INVALID", f"A span has at most {minutes} minutes, for others' visits go with it: make it shorter."
        )
    return Span(robot, first, end)


class LostKeys:
    """Erasure by two officers, for one of them."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet
        self._key = wallet.keys.identity
        self._read = wallet.reading(self._key)

    # Looking

    async def preview(self, robot: str, from_ms: int, until_ms: int) -> Preview:
        """By robot key prefix; empty suffices for one. Raises SPAN_INVALID, NAME_TOO_SHORT, NAME_AMBIGUOUS, SPAN_EMPTY."""
        if 0 < len(robot) < ID_PREFIX_MIN_CHARS:
            raise BlockRobotError("NAME_TOO_SHORT", f"Name a robot by at least {ID_PREFIX_MIN_CHARS} characters.")
        span = make_span(b"", from_ms, until_ms)
        found = [item for item in await self._opened(span) if item[2].hex().startswith(robot.lower())]
        robots = {item[2] for item in found}
        if len(robots) != 1:
            named = f" whose key begins with {robot}" if robot else ""
            if not robots:
                raise BlockRobotError("SPAN_EMPTY", f"No robot{named} opened a visit in that span.")
            keys = ", ".join(sorted(key.hex()[:10] for key in robots))
            text = f"{len(robots)} robots{named} opened visits in that span: {keys}. Name one with --robot."
            raise BlockRobotError("NAME_AMBIGUOUS", text)
        return await self._judge(Span(robots.pop(), span.from_ms, span.until_ms), found)

    async def preview_span(self, span: Span) -> Preview:
        return await self._judge(span, [item for item in await self._opened(span) if item[2] == span.robot])

    async def _opened(self, span: Span) -> list[tuple[bytes, int, bytes]]:
        """Return proven (owner, bucket, robot) in chain order, at most a day after their bucket."""
        network = self._wallet.network
        found: list[tuple[bytes, int, bytes]] = []
        number = await self._first_number(span.from_ms - LATE_MAX_MS)
        while True:
            page = await network.announcements(number, self._key)
            opened = [item for item in page.items if not item.root]
            within = [item for item in opened if span.from_ms <= item.bucket_ms < span.until_ms]
            found += [(item.owner, item.bucket_ms, item.robot) for item in within]
            number = page.next_number
            over = any(item.bucket_ms >= span.until_ms + LATE_MAX_MS for item in opened)
            if over or number >= page.count:
                return found

    async def _first_number(self, before_ms: int) -> int:
        """Bisect for a number before which all opened over a day earlier."""
        low, high = 0, (await self._wallet.network.announcements(0, self._key, 1)).count
        while high - low > 1:
            middle = (low + high) // 2
            found = await self._first_opening(middle, high)
            if found is not None and found.bucket_ms < before_ms:
                low = found.number
            else:
                high = middle
        return low

    async def _first_opening(self, number: int, end: int) -> Announcement | None:
        """Return the next announcement that opens a visit; transfers carry old times."""
        while number < end:
            page = await self._wallet.network.announcements(number, self._key, _HALVING_PAGE_COUNT)
            for item in page.items:
                if not item.root:
                    return item if item.number < end else None
            number = page.next_number
        return None

    async def _judge(self, span: Span, opened: Sequence[tuple[bytes, int, bytes]]) -> Preview:
        owners = [owner for owner, _, _ in opened]
        keys = [key for owner in owners for key in (RESTRICTION.key(owner), QUARANTINE.key(owner))]
        rows = await self._read(keys)
        visits = []
        for owner, bucket_ms, _ in opened:
            active = await active_records(self._wallet, owner)
            row, denied = RESTRICTION.among(rows, owner), QUARANTINE.among(rows, owner) is not None
            bound = [known for known in active if row is not None and row.covers(known)]
            erasable = () if denied else tuple(known for known in active if known not in bound)
            visits.append(SpanVisit(owner, bucket_ms, erasable, len(bound), denied))
        return Preview(span, tuple(visits))

    async def read_all(self) -> list[Proposal]:
        """Oldest first. Raises SESSION_REFUSED."""
        ids = await proved_list(self._read, officers.PROPOSAL_COUNT, officers.PROPOSAL_NUMBER)
        rows = await proved_rows(self._read, officers.PROPOSAL, ids)
        now_ms = (await self._wallet.network.newest_header(self._key)).timestamp_ms
        own = {keys.identity.public_key for keys in self._wallet.eras}
        return [Proposal(each, row, now_ms, row.proposer in own) for each, row in zip(ids, rows, strict=True)]

    async def find(self, start: str) -> Proposal:
        """By id prefix. Raises PROPOSAL_NOT_FOUND, NAME_TOO_SHORT, NAME_AMBIGUOUS."""
        known = await self.read_all()
        return known[resolve_id_prefix(PROPOSAL, [one.proposal_id.hex() for one in known], start)]

    # Deciding

    async def propose(self, span: Span, reason: str, visits_max: int) -> bytes:
        """Return the proposal's id. Raises CALL_REFUSED."""
        arguments = [span.robot, span.from_ms, span.until_ms, reason, visits_max]
        return (await self._call("propose", arguments)).txid

    async def approve(self, proposal: Proposal) -> None:
        """Raises CALL_REFUSED."""
        await self._call("approve", [proposal.proposal_id])

    async def stop(self, proposal: Proposal) -> None:
        """Raises CALL_REFUSED."""
        await self._call("stop", [proposal.proposal_id])

    async def erase(self, proposal: Proposal, on_progress: OnProgress) -> OrderedErasures:
        """Erase at most the approved visits; repeatable, skips restricted or denied. Raises CALL_REFUSED."""
        preview = await self.preview_span(proposal.span)
        keys = {visit.owner: officers.TOUCHED.key(proposal.proposal_id, visit.owner) for visit in preview.touched}
        touched = await self._read(list(keys.values()))
        known = [visit for visit in preview.touched if touched[keys[visit.owner]]]
        new = [visit for visit in preview.touched if not touched[keys[visit.owner]]]
        room = max(0, proposal.state.visits_max - proposal.state.visits)
        chosen = known + new[:room]
        ids: list[bytes] = []
        records = kept = visits = 0
        for number, visit in enumerate(chosen):
            on_progress(number, len(chosen))
            before = records
            try:
                for start in range(0, len(visit.erasable), RECORDS_A_CALL_MAX_COUNT):
                    part = list(visit.erasable[start : start + RECORDS_A_CALL_MAX_COUNT])
                    ids.append((await self._call("erase", [proposal.proposal_id, visit.owner, part])).txid)
                    records += len(part)
            except BlockRobotError as error:
                if error.context.get("contract_code") not in _KEPT_MEANWHILE:
                    raise
                kept += 1
            visits += records > before
        kept += sum(visit.denied or visit.restricted_count > 0 for visit in preview.visits)
        return OrderedErasures(tuple(ids), visits, records, kept, len(new[room:]))

    async def _call(self, entry: str, arguments: list[Any]) -> FinalReceipt:
        return await self._wallet.network.call(self._key, "officers", entry, arguments)


async def active_records(wallet: Wallet, owner: bytes) -> list[bytes]:
    """Return unerased records, complete by proven audit."""
    read = wallet.reading(wallet.keys.identity)
    keys = entry_keys(owner, await proved_row(read, COUNT, owner) or 0)
    values = await read(keys)
    trail = [ENTRY.convert(values[key]) for key in keys]
    ids = [entry.record_id for entry in trail if entry.kind == RECORDED_KIND]
    rows = await proved_rows(read, RECORD, ids)
    return [record_id for record_id, row in zip(ids, rows, strict=True) if row.status == "active"]
