"""Writes what was proved as the documents under data/."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from operator import itemgetter
from typing import Any

from clients.bundle import documents as doc
from clients.bundle.checks.chain_proofs import ProvedReceipt, ProvedValue
from clients.bundle.checks.visit_check import RecordFacts, VisitFacts
from clients.bundle.layout import RECORD_OPENINGS
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.records.metadata import find_chain_gaps
from consensus.rights.right_codes import Correction, commit_correction
from consensus.state.consent import CHOICES, CONSENT, LAST_STATEMENT_HEIGHT, StepRow, read_choices
from consensus.state.erasure import ErasureReceiptRow
from consensus.state.identity import MEMBER, MemberRow
from consensus.state.keys import Row, Rows
from consensus.state.rights import CORRECTION, RESTRICTION

WORDS = ("given", "refused", "withdrawn", "objected")
PART_OF_A_VISIT = -1


def plain(value: Any) -> Any:
    """Return a value as JSON, bytes and keys as hexadecimal."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, dict):
        return {str(plain(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def build_visit(number: int, facts: VisitFacts, frames: Sequence[list[doc.FrameDocument]]) -> doc.VisitDocument:
    state = facts.state
    pairs = zip(facts.records, frames, strict=True)
    return doc.VisitDocument(
        number=number,
        owner=facts.owner.hex(),
        robot=state.robot.hex(),
        purpose=state.purpose,
        bucket_ms=state.bucket_ms,
        status=state.status,
        record_count=state.record_count,
        missing=_count_missing(facts) if facts.is_whole else PART_OF_A_VISIT,
        is_whole=facts.is_whole,
        proved_from_height=facts.heights[0],
        proved_until_height=facts.heights[1],
        records=[_build_record(place, record, shown) for place, (record, shown) in enumerate(pairs, 1)],
    )


def _count_missing(facts: VisitFacts) -> int:
    """Records closed or chained over, but never submitted."""
    known = [record.metadata for record in facts.records if record.metadata is not None]
    expected = max((metadata.index_in_visit + 1 for metadata in known), default=0)
    if facts.state.status == "closed":
        expected = facts.state.record_count
    unread = len(facts.records) - len(known)
    return max(0, max(expected - len(known), len(find_chain_gaps(known))) - unread)


def _build_record(number: int, record: RecordFacts, frames: list[doc.FrameDocument]) -> doc.RecordDocument:
    state, metadata = record.state, record.metadata
    return doc.RecordDocument(
        record_id=record.record_id.hex(),
        number=number,
        status=state.status,
        robot=state.robot.hex(),
        bucket_ms=state.bucket_ms,
        expires_at_ms=state.expires_at_ms,
        recorded_at_height=state.height,
        transaction=state.txid.hex(),
        commitment_root=state.commitment_root.hex(),
        metadata_proved=record.metadata_proved,
        sensor=metadata.sensor if metadata else "",
        started_at_ms=metadata.started_at_ms if metadata else 0,
        ended_at_ms=metadata.ended_at_ms if metadata else 0,
        frame_count=metadata.frame_count if metadata else 0,
        index_in_visit=metadata.index_in_visit if metadata else 0,
        width=metadata.width if metadata else 0,
        height=metadata.height if metadata else 0,
        withheld=dict(metadata.withheld) if metadata else {},
        erased_frames=state.erased_frames,
        verdict=record.verdict.verdict if record.verdict else "",
        frames=frames,
    )


def build_audit_trail(visits: Sequence[VisitFacts]) -> doc.AuditTrailDocument:
    rows = [
        doc.AuditDocument(
            owner=facts.owner.hex(),
            index=index,
            record_id=entry.record_id.hex(),
            kind=entry.kind,
            time_ms=entry.time,
            height=entry.height,
            data=plain(entry.data),
        )
        for facts in visits
        for index, entry in facts.entries
    ]
    return doc.AuditTrailDocument(sorted(rows, key=lambda row: (row.height, row.owner, row.index)))


def build_access_log(visits: Sequence[VisitFacts]) -> doc.AccessLogDocument:
    rows = [
        doc.AccessDocument(
            access_id=access_id.hex(),
            owner=facts.owner.hex(),
            records=plain(row.records),
            purpose=row.purpose,
            time_ms=row.time,
            released=plain(row.released),
            refused=plain(row.refused),
        )
        for facts in visits
        for access_id, row in facts.accesses.items()
    ]
    return doc.AccessLogDocument(sorted(rows, key=lambda given: (given.time_ms, given.access_id)))


def build_erasures(visits: Sequence[VisitFacts]) -> doc.ErasuresDocument:
    rows = [
        doc.ErasureDocument(
            erasure_id=erasure_id.hex(),
            owner=facts.owner.hex(),
            records=plain(row.records),
            frames=row.frames,
            status=row.status,
            time_ms=row.time,
            custodians=plain(row.custodians),
            receipts=[_build_receipt(*each) for each in sorted(row.receipts.items(), key=itemgetter(0))],
        )
        for facts in visits
        for erasure_id, row in facts.erasures.items()
    ]
    return doc.ErasuresDocument(sorted(rows, key=lambda given: (given.time_ms, given.erasure_id)))


def _build_receipt(custodian: bytes, given: ErasureReceiptRow) -> doc.ErasureReceiptDocument:
    return doc.ErasureReceiptDocument(
        custodian=custodian.hex(),
        destroyed_frames=given.destroyed_frames,
        remains=given.remains,
        remains_until_ms=given.remains_until_ms,
        digest=given.digest.hex(),
        time_ms=given.time,
    )


Texts = Mapping[tuple[str, int], str]
"""What corrections say, by the visit's owner key (hexadecimal) and the correction's number."""


def open_corrections(visits: Sequence[VisitFacts], openings: Sequence[doc.CorrectionOpening]) -> Texts:
    """Raises BUNDLE_UNPROVEN without commitment."""
    numbers = {facts.owner.hex(): place for place, facts in enumerate(visits)}
    if any(row.visit not in numbers for row in openings):
        raise BlockRobotError("BUNDLE_UNPROVEN", "A correction is of a visit that is not in the bundle.")
    places = [(numbers[row.visit], row.number) for row in openings]
    if places != sorted(set(places)):
        raise BlockRobotError("BUNDLE_INVALID", "The corrections are not in the order of the visits.")
    for row, (place, number) in zip(openings, places, strict=True):
        for text in (row.salt, *row.record_ids):
            doc.read_bytes(RECORD_OPENINGS, text)
        known = visits[place].corrections
        given = Correction(row.kind, row.text, row.salt, row.visit, row.record_ids)
        if not 0 <= number < len(known) or known[number].commitment != commit_correction(given):
            raise BlockRobotError("BUNDLE_UNPROVEN", "A correction is not what its maker said on the ledger.")
    return {(row.visit, row.number): row.text for row in openings}


def _plain_row(rows: Rows[Any], row: Row) -> Any:
    return plain(decode_value(rows.encode(row)))


def build_rights(visits: Sequence[VisitFacts], texts: Texts) -> doc.RightsDocument:
    rows = [
        doc.VisitRightsDocument(
            owner=facts.owner.hex(),
            restriction=None if facts.restriction is None else _plain_row(RESTRICTION, facts.restriction),
            objection=plain(facts.objection),
            quarantine=plain(facts.quarantine),
            corrections=[
                _plain_row(CORRECTION, row) | {"text": texts.get((facts.owner.hex(), number), "")}
                for number, row in enumerate(facts.corrections)
            ],
        )
        for facts in visits
    ]
    return doc.RightsDocument(rows)


NO_PERSON = doc.ConsentsDocument("", "", "", "", 0, 0, [], [])


def read_person(proved: Mapping[bytes, ProvedValue]) -> tuple[bytes, MemberRow]:
    """Raises BUNDLE_UNPROVEN."""
    keys = [key for key in proved if MEMBER.owns(key)]
    value = proved[keys[0]].value if len(keys) == 1 else None
    if value is None:
        raise BlockRobotError("BUNDLE_UNPROVEN", "The bundle does not prove who the person is.")
    row, (member,) = MEMBER.convert(value), MEMBER.split(keys[0])
    if set(proved) != {keys[0], CHOICES.key(row.handle), LAST_STATEMENT_HEIGHT.key(row.handle)}:
        raise BlockRobotError(
            "BUNDLE_UNPROVEN", "The proofs of the person leave something out, or hold something else."
        )
    return member, row


def build_consents(
    proved: Mapping[bytes, ProvedValue], receipts: Sequence[ProvedReceipt], former: Set[bytes] = frozenset()
) -> doc.ConsentsDocument:
    """`former`: proved earlier member keys. Raises BUNDLE_UNPROVEN."""
    member, row = read_person(proved)
    choices = read_choices(proved[CHOICES.key(row.handle)].value)
    return doc.ConsentsDocument(
        member=member.hex(),
        handle=row.handle.hex(),
        role=row.role,
        status=row.status,
        proved_at_height=min(proof.height for proof in proved.values()),
        last_word_height=proved[LAST_STATEMENT_HEIGHT.key(row.handle)].value or 0,
        choices=[
            doc.ConsentDocument(
                purpose,
                sensor,
                [_build_step(step) for step in steps],
            )
            for (purpose, sensor), steps in sorted(choices.items())
        ],
        history=[_build_word(former | {member}, receipt) for receipt in _in_order(receipts)],
    )


def _build_step(step: StepRow) -> doc.ConsentStepDocument:
    period = (step.from_ms, step.until_ms)
    return doc.ConsentStepDocument(step.height, step.status, step.since_ms, *period, step.mandate.hex())


def _in_order(receipts: Sequence[ProvedReceipt]) -> Sequence[ProvedReceipt]:
    places = [(receipt.height, receipt.index) for receipt in receipts]
    if places != sorted(set(places)):
        raise BlockRobotError("BUNDLE_UNPROVEN", "The receipts of consent are not in the order of the chain.")
    return receipts


def _build_word(members: Set[bytes], proof: ProvedReceipt) -> doc.ConsentWordDocument:
    """Raises BUNDLE_UNPROVEN."""
    given = [
        (event.name, decode_value(event.data))
        for event in proof.receipt.events
        if event.contract == CONSENT and event.name in WORDS
    ]
    if len(given) != 1 or given[0][1]["member"] not in members or given[0][1]["mandate"] or not proof.receipt.ok:
        raise BlockRobotError("BUNDLE_UNPROVEN", "A receipt is no word of this person on consent.")
    ((kind, data),) = given
    return doc.ConsentWordDocument(
        kind=kind,
        purposes=plain(data["purposes"]),
        sensors=plain(data.get("sensors", [])),
        from_height=data["height"],
        transaction=proof.receipt.txid.hex(),
        height=proof.height,
        time_ms=proof.time_ms,
    )
