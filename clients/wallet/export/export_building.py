"""Collect a person's data with proofs. Pictures are requested on chain only after planning; proofs are read last, to
cover the export and concurrent erasures.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

from clients.bundle import documents as doc
from clients.bundle.checks.visit_check import RECORDS_MAX_COUNT
from clients.bundle.proving import Heard, Proofs, never_heard
from clients.bundle.writing import Contents
from clients.wallet.consent.receipt_collection import collect_receipts
from clients.wallet.ledger.proof_collection import PersonProofs, VisitProofs, collect_person, collect_visit
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.records.viewing import STATUS_CORRUPTED, RecordView, RecordViewer
from clients.wallet.store.keystore import KnownVisit
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.limits import TIME_BUCKET_MS, VISIT_MAX_MS
from consensus.primitives.encoding import encode
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import derive_box_key
from consensus.records.renditions import ENCODING_PNG16, encode_rendition
from consensus.rights.right_codes import commit_correction
from consensus.state.records import RECORD, VISIT
from consensus.state.rights import CORRECTION, CORRECTION_COUNT, QUARANTINE

SPREAD_MAX_MS = 4_000
HELD_MAX_BYTES = 1 << 30

Sleep = Callable[[float], Awaitable[None]]

__all__ = ["ExportChoice", "Exporter", "Plan"]


@dataclass(frozen=True, slots=True)
class ExportChoice:
    """Export selection. Empty `records`: all; times in robot-clock ms, 0 unbounded."""

    records: tuple[bytes, ...] = ()
    from_ms: int = 0
    until_ms: int = 0
    pictures: bool = True
    identity: bool = True
    purpose: str = "own-access"

    @property
    def is_everything(self) -> bool:
        """Whether whole visits are exported."""
        return not (self.records or self.from_ms or self.until_ms)

    def selection(self) -> doc.Selection:
        ids = [record_id.hex() for record_id in self.records]
        return doc.Selection(ids, self.from_ms, self.until_ms, self.pictures, self.identity, self.purpose)


@dataclass(frozen=True, slots=True)
class ChosenVisit:
    """An exported visit: readable records, and ids of all chosen (None: whole)."""

    visit: KnownVisit
    entries: tuple[RecordEntry, ...]
    chosen_ids: frozenset[bytes] | None
    unreadable_ids: tuple[bytes, ...]
    named_count: int


@dataclass(frozen=True, slots=True)
class Plan:
    """What would be exported, before any request."""

    wanted: ExportChoice
    visits: tuple[ChosenVisit, ...]

    @property
    def record_count(self) -> int:
        return sum(len(chosen.entries) for chosen in self.visits)

    @property
    def named_count(self) -> int:
        """With records that are erased or unreadable: the bundle has their proofs."""
        return sum(chosen.named_count for chosen in self.visits)


@dataclass
class _Held:
    """Frames and empty frames in memory: pictures reach disk only in the bundle."""

    frames: dict[tuple[bytes, int], bytes] = field(default_factory=dict)
    rooms: dict[bytes, bytes | None] = field(default_factory=dict)
    size: int = 0

    def committed(self, name: str, record_id: bytes, index: int) -> bytes:  # noqa: ARG002
        return self.frames[record_id, index]

    def background(self, digest: bytes) -> bytes | None:
        return self.rooms.get(digest)

    def add(self, content: bytes) -> bytes:
        """Raises EXPORT_TOO_LARGE."""
        self.size += len(content)
        if self.size > HELD_MAX_BYTES:
            raise refusal("EXPORT_TOO_LARGE", "export_too_large")
        return content


class Exporter:
    """One export of one wallet."""

    def __init__(
        self,
        wallet: Wallet,
        heard: Heard = never_heard,
        *,
        viewing: RecordViewer | None = None,
        sleep: Sleep = asyncio.sleep,
        at_once: bool = False,
    ) -> None:
        """`at_once` skips pauses between visits, which lets ledger readers link them."""
        self._wallet = wallet
        self._sleep = sleep
        self._at_once = at_once
        self._heard = heard
        self._viewing = viewing or RecordViewer(wallet)
        self._held = _Held()
        self._views: dict[bytes, RecordView] = {}
        self._problems: list[doc.Problem] = []

    async def plan(self, wanted: ExportChoice) -> Plan:
        """Without requests. Raises RECORD_NOT_FOUND, also if nothing is left."""
        reports = await self._wallet.records()
        known = {record_id for report in reports for record_id in _all_ids(report)}
        for record_id in wanted.records:
            if record_id not in known:
                raise refusal("RECORD_NOT_FOUND", "no_record_named", name=record_id.hex())
        chosen = [_choose(report, wanted) for report in reports]
        visits = tuple(visit for visit in chosen if visit is not None)
        if not visits and not (wanted.identity and wanted.is_everything):
            raise refusal("RECORD_NOT_FOUND", "nothing_recorded")
        return Plan(wanted, visits)

    async def collect(self, plan: Plan, now_ms: int) -> Contents:
        """Request pictures, read proofs, return contents dated `now_ms`; failures become problems. Raises
        EXPORT_TOO_LARGE and proof errors.
        """
        for chosen in plan.visits:
            for record_id in chosen.unreadable_ids:
                self._note(record_id, "ENVELOPE_INVALID", "The robot sealed it wrongly: your keys do not open it.")
        if plan.wanted.pictures:
            await self._fetch_pictures(plan)
        wallet = self._wallet
        visits = []
        for number, chosen in enumerate(sorted(plan.visits, key=lambda each: each.visit.sequence), 1):
            visits.append((chosen, await collect_visit(wallet, chosen.visit, chosen.chosen_ids)))
            self._heard("proofs of visits", number, len(plan.visits))
        # A visit that was found by its new key alone has another number in the wallet than on the chain.
        visits.sort(key=lambda pair: _sequence(*pair))
        person, signed = PersonProofs(None, (), ()), None
        if plan.wanted.identity:
            held = await collect_receipts(wallet, self._heard)
            person = await collect_person(wallet, held.pairs)
            self._problems += [*held.problems, *person.problems]
            signed = held.document()
        openings = [
            opening
            for chosen, proofs in visits
            for entry in sorted(chosen.entries, key=lambda each: (each.metadata.index_in_visit, each.record_id))
            if (opening := self._open(entry, proofs.values, person.sealing)) is not None
        ]
        corrections = [
            row
            for chosen, proofs in visits
            if plan.wanted.identity
            for row in self._open_corrections(chosen.visit.owner, proofs.values)
        ]
        epochs = [encode(proof).hex() for proof in wallet.network.light_client.epochs]
        proofs = Proofs(
            chain=doc.ChainProofs(epochs),
            person=person.state,
            visits=tuple(proofs.document for _, proofs in visits),
            receipts=doc.ReceiptProofs(list(person.receipts)),
            openings=doc.RecordOpenings(openings, corrections),
            keys=person.keys,
            signed=signed,
        )
        problems = tuple(sorted(self._problems, key=lambda each: (each.record_id, each.code, each.sentence)))
        return Contents(
            wallet.genesis, proofs, plan.wanted.selection(), problems, now_ms, self._held, self._key_finder(plan)
        )

    def _key_finder(self, plan: Plan) -> Callable[[bytes], PrivateKey]:
        visits = {chosen.visit.current or chosen.visit.owner: chosen.visit for chosen in plan.visits}

        def find(public_key: bytes) -> PrivateKey:
            if public_key in visits:
                return self._wallet.owner_key(visits[public_key])
            return self._wallet.keys.identity

        return find

    def _note(self, record_id: bytes, code: str, sentence: str) -> None:
        self._problems.append(doc.Problem(record_id.hex(), code, sentence))

    # Pictures

    async def _fetch_pictures(self, plan: Plan) -> None:
        """In random order with pauses, against linking."""
        done = 0
        visits = [chosen for chosen in plan.visits if chosen.entries]
        secrets.SystemRandom().shuffle(visits)
        for number, chosen in enumerate(visits):
            if number and not self._at_once:
                await self._sleep(secrets.randbelow(SPREAD_MAX_MS) / 1000)
            active = [entry for entry in chosen.entries if entry.state.status == "active"]
            for part in await self._viewing.split_requests(active):
                for entry, access_id in await self._request(part, plan.wanted.purpose):
                    await self._fetch(entry, access_id)
                    done += 1
                    self._heard("records fetched", done, plan.record_count)

    async def _request(self, entries: list[RecordEntry], purpose: str) -> list[tuple[RecordEntry, bytes]]:
        try:
            access_id = await self._viewing.request_access(entries, purpose)
        except BlockRobotError as error:
            if error.code != "CALL_REFUSED":
                raise
            if len(entries) == 1:
                self._note(entries[0].record_id, error.code, f"The ledger refused access: {error.detail}")
                return []
            return [pair for entry in entries for pair in await self._request([entry], purpose)]
        return [(entry, access_id) for entry in entries]

    async def _fetch(self, entry: RecordEntry, access_id: bytes) -> None:
        try:
            view = await self._viewing.view(entry, access_id)
        except BlockRobotError as error:
            self._note(entry.record_id, error.code, f"No custodian gave it: {error.detail}")
            return
        self._views[entry.record_id] = view
        if view.corrupted:
            places = ", ".join(map(str, view.corrupted))
            self._note(
                entry.record_id, "RENDITION_CORRUPTED", f"Changed at every custodian that answered: pictures {places}."
            )
        if view.miscounted:
            counts = f"{view.frames_counted} by the robot's own count, {len(view.frames)} that it committed to"
            self._note(entry.record_id, "FRAMES_MISCOUNTED", f"The pictures do not add up: {counts}.")
        for frame in view.frames:
            if frame.rendition is None or frame.status == STATUS_CORRUPTED:
                continue
            self._held.frames[entry.record_id, frame.index] = self._held.add(encode_rendition(frame.rendition))
            room = frame.rendition.background_id
            is_depth = frame.rendition.encoding == ENCODING_PNG16 and frame.rendition.pixels
            if is_depth and room not in self._held.rooms:
                self._held.rooms[room] = await self._fetch_room(entry, frame.rendition)

    async def _fetch_room(self, entry: RecordEntry, rendition: Any) -> bytes | None:
        found = await self._viewing.background(rendition, entry)
        if found is not None:
            return self._held.add(found)
        error = self._viewing.missing_rooms[rendition.background_id]
        sentence = f"The empty room could not be had ({error.detail}): its pictures are there without it."
        self._note(b"", error.code, sentence)
        return None

    # Opening

    def _open(
        self, entry: RecordEntry, values: dict[bytes, Any], sealing: tuple[bytes, ...]
    ) -> doc.RecordOpening | None:
        state = RECORD.convert(values[RECORD.key(entry.record_id)])
        if QUARANTINE.among(values, entry.visit.owner) is not None:
            self._note(entry.record_id, "NOT_PERMITTED", "The visit is quarantined: it may show somebody else.")
            return None
        if state.status != "active":
            if entry.state.status == "active":
                self._note(entry.record_id, "CLIP_ERASED", "Erased, or asked to be, while the export was made.")
            return None
        if not 0 <= entry.metadata.index_in_visit < RECORDS_MAX_COUNT:
            self._note(entry.record_id, "VALUE_INVALID", "The robot gave it an impossible place in the visit.")
            return None
        box_key = b""
        sealed_to = self._wallet.open_metadata(state.sealed_metadata)[1]
        # What was sealed to a key that is not proved to be the owner's is the exporter's word.
        if sealed_to.sealing_public in sealing:
            box_key = derive_box_key(sealed_to.sealing, state.sealed_metadata)
        leaves, salts = self._open_frames(entry, state.erased_frames)
        return doc.RecordOpening(entry.record_id.hex(), encode(entry.metadata).hex(), box_key.hex(), leaves, salts)

    def _open_corrections(self, owner: bytes, values: dict[bytes, Any]) -> list[doc.CorrectionOpening]:
        known = {commit_correction(each): each for each in self._wallet.store.content.corrections}
        rows = []
        for number in range(CORRECTION_COUNT.among(values, owner) or 0):
            correction = known.get(CORRECTION.convert(values[CORRECTION.key(owner, number)]).commitment)
            if correction is not None:
                rows.append(
                    doc.CorrectionOpening(
                        correction.visit,
                        number,
                        correction.kind,
                        correction.record_ids,
                        correction.text,
                        correction.salt,
                    )
                )
        return rows

    def _open_frames(self, entry: RecordEntry, erased: list[int]) -> tuple[list[str], list[str]]:
        view = self._views.get(entry.record_id)
        if view is None:
            return [], []
        salts = {
            frame.index: frame.salt
            for frame in view.frames
            if (entry.record_id, frame.index) in self._held.frames and frame.index not in erased
        }
        late = [frame.index for frame in view.frames if frame.index in erased and frame.salt]
        if late:
            self._note(entry.record_id, "CLIP_ERASED", f"Erased while the export was made: pictures {late}.")
        leaves = view.commitment_leaves
        return [leaf.hex() for leaf in leaves], [salts.get(index, b"").hex() for index in range(len(leaves))]


def _sequence(chosen: ChosenVisit, proofs: VisitProofs) -> int:
    return VISIT.convert(proofs.values[VISIT.key(chosen.visit.owner)]).sequence


def _all_ids(report: VisitReport) -> list[bytes]:
    return [*(entry.record_id for entry in report.records), *report.erased_ids, *report.unreadable_ids]


def _choose(report: VisitReport, wanted: ExportChoice) -> ChosenVisit | None:
    if wanted.is_everything:
        return ChosenVisit(report.visit, report.records, None, report.unreadable_ids, len(_all_ids(report)))
    opened = {entry.record_id: (entry.metadata.started_at_ms, entry.metadata.ended_at_ms) for entry in report.records}
    begin = report.visit.bucket_ms
    span = (begin, begin + VISIT_MAX_MS + TIME_BUCKET_MS)
    ids = frozenset(
        record_id
        for record_id in _all_ids(report)
        if (not wanted.records or record_id in wanted.records) and _overlaps(*opened.get(record_id, span), wanted)
    )
    if not ids:
        return None
    return ChosenVisit(
        visit=report.visit,
        entries=tuple(entry for entry in report.records if entry.record_id in ids),
        chosen_ids=ids,
        unreadable_ids=tuple(record_id for record_id in report.unreadable_ids if record_id in ids),
        named_count=len(ids),
    )


def _overlaps(started_ms: int, ended_ms: int, wanted: ExportChoice) -> bool:
    return ended_ms >= wanted.from_ms and (not wanted.until_ms or started_ms < wanted.until_ms)
