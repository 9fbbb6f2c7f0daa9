"""What `blockrobot wallet` answers with `--json` of records: listed, fetched, checked, exported, erased."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Height, Hex, TimeMs, doc


class FrameStatus(Answer, frozen=True, kw_only=True):
    """A picture, label or sound of a record."""

    number: Annotated[Count, doc("Its place in the record, from 1, as `wallet erase --frames` takes it")]
    status: Annotated[str, doc("`ok`, `corrupted`, `erased`, or `notice` (a note of what was withheld)")]


class FetchedRecord(Answer, frozen=True, kw_only=True):
    """A record that was fetched."""

    record_id: Annotated[Hex, doc("The record")]
    custodians: Annotated[list[str], doc("Names of the custodians that released it")]
    frames: Annotated[list[FrameStatus], doc("Each picture, label or sound")]


class MissingRoom(Answer, frozen=True, kw_only=True):
    """An empty frame that nobody had: its pictures show the person alone."""

    sha256: Annotated[Hex, doc("The frame")]
    code: Annotated[str, doc("Why: `EMPTY_FRAME_WITHDRAWN` if the chain proves it, else what a custodian refused")]


class WrittenPictures(Answer, frozen=True, kw_only=True):
    """Where fetched pictures were written."""

    out: Annotated[str, doc("The folder of the pictures")]
    earlier: Annotated[list[str], doc("Files of earlier looks that are still there, and not of this one")]
    missing_rooms: Annotated[list[MissingRoom], doc("Each empty frame that nobody had")]


class ViewedRecord(FetchedRecord, frozen=True, kw_only=True):
    """A record of one's own that was fetched and checked."""

    verdict: Annotated[str, doc("`verified` if everything held, else `corrupted`")]
    frames_counted: Annotated[Count, doc("How many the robot counted, by what it sealed to you")]
    frames_committed: Annotated[Count, doc("How many it committed to on the chain")]


class ViewAnswer(WrittenPictures, frozen=True, kw_only=True):
    """Records that were fetched, checked and written as pictures."""

    records: Annotated[list[ViewedRecord], doc("Each record that was fetched")]
    sheets: Annotated[list[str], doc("Contact sheets and animations that were written")]


class VerifyAnswer(Answer, frozen=True, kw_only=True):
    """Records that were checked."""

    records: Annotated[list[ViewedRecord], doc("Each record that was fetched")]
    out: Annotated[None, doc("No folder: nothing is written; always null")]


class RecordRow(Answer, frozen=True, kw_only=True):
    """A record of one's own."""

    record_id: Annotated[Hex, doc("The record")]
    visit: Annotated[Hex, doc("The visit's name: its first owner key")]
    status: Annotated[str, doc("`active`, or `erasing` once its erasure is asked for")]
    sensor: Annotated[str, doc("Which sensor took it; `notice` for a note of what was withheld")]
    started_at_ms: Annotated[TimeMs, doc("Its beginning, by the robot's clock")]
    ended_at_ms: Annotated[TimeMs, doc("Its end, by the robot's clock")]
    frames: Annotated[Count, doc("How many pictures, labels or sounds it has")]
    erased_numbers: Annotated[list[Count], doc("Places in the record of those that are erased, from 1")]
    index_in_visit: Annotated[Count, doc("Its place in the visit, from 0")]
    expires_at_ms: Annotated[TimeMs, doc("When its time is over")]
    withheld: Annotated[dict[str, Count], doc("How many frames the robot kept back, by reason")]
    restricted: Annotated[bool, doc("Whether a restriction is on it")]


class VisitRestriction(Answer, frozen=True, kw_only=True):
    """What restricts a visit."""

    ground: Annotated[str, doc("Why: `accuracy`, `unlawful`, `legal-claim` or `objection`")]
    whole_visit: Annotated[bool, doc("Whether it is on every record")]
    kept_until_ms: Annotated[TimeMs | None, doc("Until when it is kept beyond its time; null if it is not")]


class VisitBreachEnd(Answer, frozen=True, kw_only=True):
    """How an officer ended a breach."""

    breach_id: Annotated[Hex, doc("The breach")]
    outcome: Annotated[str, doc("`erased` or `released`")]
    reason: Annotated[str, doc("The reason's code")]
    time_ms: Annotated[TimeMs, doc("When")]


class ErasedByOfficers(Answer, frozen=True, kw_only=True):
    """What two officers together had erased of a visit."""

    proposal_id: Annotated[Hex, doc("Their proposal")]
    reason: Annotated[str, doc("The reason's code")]
    records: Annotated[Count, doc("How many records")]
    time_ms: Annotated[TimeMs, doc("When")]


class VisitRightsRow(Answer, frozen=True, kw_only=True):
    """Rights that were exercised for a visit, and what became of them."""

    restriction: Annotated[VisitRestriction | None, doc("What restricts it; null if nothing does")]
    objected_purposes: Annotated[list[str], doc("Purposes for which nothing of it is released")]
    corrections: Annotated[Count, doc("How many corrections stand beside it")]
    breach_id: Annotated[Hex | None, doc("The breach for which it is in quarantine; null if it is in none")]
    breach_end: Annotated[VisitBreachEnd | None, doc("How an officer ended that breach; null if none did")]
    erased_by_officers: Annotated[list[ErasedByOfficers], doc("What officers had erased of it")]


class VisitRow(VisitRightsRow, frozen=True, kw_only=True):
    """A visit and its records."""

    visit: Annotated[Hex, doc("The visit's name: its first owner key")]
    robot: Annotated[Hex, doc("The robot's key")]
    robot_name: Annotated[str, doc("What its organisation calls it; empty if it has no name")]
    robot_place: Annotated[str, doc("Where it is; empty if that was not said")]
    closed: Annotated[bool, doc("Whether the robot closed it")]
    missing_records: Annotated[Count, doc("How many records the robot took and never brought")]
    erased_records: Annotated[list[Hex], doc("Ids of records that are erased")]
    unreadable_records: Annotated[list[Hex], doc("Ids of records that do not open")]
    needs_former_words: Annotated[bool, doc("Whether that is because former words are missing")]
    records: Annotated[list[RecordRow], doc("Each record that is asked for")]


class FormerVisits(Answer, frozen=True, kw_only=True):
    """Visits of which the present words do not decide."""

    taken_visits: Annotated[list[Hex], doc("Visits that obey somebody else's key")]
    exposed_visits: Annotated[list[Hex], doc("Visits of which a key from former words still decides")]
    stuck_visits: Annotated[list[Hex], doc("Visits that obey former words and can be given no other key any more")]


class RecordsAnswer(FormerVisits, frozen=True, kw_only=True):
    """What was recorded of the person, or what fits."""

    notice_changed_to: Annotated[Count | None, doc("A notice's version that came since the last consent; null if none")]
    mandate_id: Annotated[Hex | None, doc("The mandate by which somebody acts for this person, or is to; null if none")]
    visits: Annotated[list[VisitRow], doc("Each visit on this page")]
    page: Annotated[Count, doc("This page, from 1")]
    pages: Annotated[Count, doc("How many there are")]
    matching_records: Annotated[Count, doc("How many records are asked for, on all pages")]
    all_records: Annotated[Count, doc("How many there are")]


class AuditEvent(Answer, frozen=True, kw_only=True):
    """Something that happened to records."""

    visit: Annotated[Hex, doc("The visit's name: its first owner key")]
    index: Annotated[Count, doc("Its number in the visit's audit, from 0")]
    record_id: Annotated[Hex, doc("The record; empty if it is about several, or the visit")]
    records: Annotated[list[Hex], doc("Ids of all records that it names")]
    kind: Annotated[str, doc("What happened, a code")]
    time_ms: Annotated[TimeMs, doc("The block's time")]
    height: Annotated[Height, doc("The block that holds it")]
    detail: Annotated[str, doc("More of it, in a few English words; empty if the kind says it all")]


class AuditAnswer(Answer, frozen=True, kw_only=True):
    """Everything that happened to one's records."""

    entries: Annotated[list[AuditEvent], doc("What happened, in the order of the chain")]


class ProbeAnswer(Answer, frozen=True, kw_only=True):
    """How custodians refuse what is not this wallet's: a command for demonstrations that `--help` leaves out."""

    refusals: Annotated[dict[str, str], doc("By custodian and asker, the refusal's code, or `RELEASED`")]


class ExportProblem(Answer, frozen=True, kw_only=True):
    """What a bundle lacks."""

    record_id: Annotated[str, doc("Of which record; empty: of all")]
    code: Annotated[str, doc("The error's code")]
    sentence: Annotated[str, doc("Why, in English")]


class ExportAnswer(Answer, frozen=True, kw_only=True):
    """A bundle that was written."""

    file: Annotated[str, doc("The bundle")]
    bytes: Annotated[Count, doc("Its size in bytes")]
    is_complete: Annotated[bool, doc("Whether everything that was asked for is in it")]
    visits: Annotated[Count, doc("How many visits")]
    records: Annotated[Count, doc("How many records")]
    pictures: Annotated[Count, doc("How many pictures, labels and sounds")]
    audit_entries: Annotated[Count, doc("How many events")]
    accesses: Annotated[Count, doc("How many requests for pictures")]
    erasures: Annotated[Count, doc("How many requests for erasure")]
    consent_receipts: Annotated[Count, doc("How many words on consent after registering, with receipts")]
    signed_consent_receipts: Annotated[Count, doc("How many receipts that both sides signed")]
    proved_until_height: Annotated[Height, doc("The block as of which it is proved")]
    genesis_id: Annotated[Hex, doc("The genesis hash of its network")]
    problems: Annotated[list[ExportProblem], doc("What could not be had")]
    not_proved: Annotated[list[str], doc("What the bundle leaves open, a sentence each")]


class KeptConfirmation(Answer, frozen=True, kw_only=True):
    """What a custodian said of a complete erasure."""

    custodian: Annotated[Hex, doc("Its key")]
    destroyed_frames: Annotated[Count, doc("How many pictures it destroyed")]
    time_ms: Annotated[TimeMs, doc("When")]


class KeptReceipt(Answer, frozen=True, kw_only=True):
    """A receipt whose proof the wallet keeps."""

    txid: Annotated[Hex, doc("The transaction; of an erasure its id")]
    kind: Annotated[str, doc("`erasure`, `registration`, `rotation`, `given`, `refused`, `withdrawn` or `other`")]
    height: Annotated[Height, doc("Its block")]
    time_ms: Annotated[TimeMs, doc("The block's time")]
    proved_height: Annotated[Height, doc("The block that its last part was proved by")]
    confirmed: Annotated[list[KeptConfirmation], doc("What custodians said of a complete erasure")]


class KeptProblem(Answer, frozen=True, kw_only=True):
    """A proof that does not hold."""

    code: Annotated[str, doc("The error's code")]
    detail: Annotated[str, doc("Why")]


class ReceiptsAnswer(Answer, frozen=True, kw_only=True):
    """The receipts whose proofs the wallet keeps, each checked; no node was asked."""

    receipts: Annotated[list[KeptReceipt], doc("Each receipt that holds, oldest first")]
    problems: Annotated[list[KeptProblem], doc("Proofs that do not hold")]
    dropped: Annotated[Count, doc("Older proofs that were dropped: the file is bounded")]


class CustodianAnswer(Answer, frozen=True, kw_only=True):
    """What a custodian said of an erasure."""

    name: Annotated[str, doc("Its name and organisation")]
    confirmed_at_ms: Annotated[TimeMs | None, doc("When it confirmed; null if it has not yet")]
    destroyed_frames: Annotated[Count, doc("How many pictures it destroyed")]
    remains: Annotated[str, doc("What remains there, a code; empty until it confirmed")]
    remains_until_ms: Annotated[TimeMs, doc("Until when; 0 until it confirmed")]
    overdue: Annotated[bool, doc("Whether it should have confirmed long ago")]


class ErasureRow(Answer, frozen=True, kw_only=True):
    """A request to erase, and what became of it."""

    erasure_id: Annotated[Hex, doc("The request")]
    visit: Annotated[Hex, doc("The visit's name: its first owner key")]
    asked_at_ms: Annotated[TimeMs, doc("When it was asked for")]
    records: Annotated[Count, doc("How many records")]
    frames: Annotated[list[Count], doc("Indexes of the pictures, if only some of one record")]
    status: Annotated[str, doc("`requested` or `complete`")]
    custodians: Annotated[list[CustodianAnswer], doc("What each custodian said")]


class ErasuresAnswer(Answer, frozen=True, kw_only=True):
    """What one asked to erase."""

    erasures: Annotated[list[ErasureRow], doc("Each request, oldest first")]


ANSWERS: AnswersByCommand = {
    "wallet records": RecordsAnswer,
    "wallet view": ViewAnswer,
    "wallet verify": VerifyAnswer,
    "wallet audit": AuditAnswer,
    "wallet probe": ProbeAnswer,
    "wallet export": ExportAnswer,
    "wallet receipts": ReceiptsAnswer,
    "wallet erasures": ErasuresAnswer,
}
