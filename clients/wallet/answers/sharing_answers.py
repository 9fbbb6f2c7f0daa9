"""What `blockrobot wallet` answers with `--json` of sharing, of what was shared with one, and of erasing."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, UnsetType

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Height, Hex, Problem, TimeMs, doc
from clients.wallet.answers.record_answers import FetchedRecord, WrittenPictures


class SharedRecords(Answer, frozen=True, kw_only=True):
    """Records that are shared by one grant."""

    grant_id: Annotated[Hex, doc("The grant")]
    visit: Annotated[Hex, doc("The visit's name: its first owner key")]
    records: Annotated[list[Hex], doc("Ids of the records that are shared")]
    until_ms: Annotated[TimeMs, doc("When it ends")]


class MadeShare(SharedRecords, frozen=True, kw_only=True):
    """A grant that was made now."""

    left_out: Annotated[list[Hex], doc("Ids of records that could not be shared")]
    pictures: Annotated[Count, doc("How many pictures can be opened")]
    custodians: Annotated[list[str], doc("Names of the custodians that hold the parts of the key")]
    custodians_away: Annotated[list[str], doc("Names of those that could not be reached")]


class ShareAnswer(Answer, frozen=True, kw_only=True):
    """Records that were shared."""

    handle: Annotated[Hex, doc("The other's handle")]
    role: Annotated[str, doc("The other's role")]
    purpose: Annotated[str, doc("The purpose's code")]
    shared: Annotated[list[MadeShare], doc("Each grant that was made: one for 64 records")]


class GranteeLook(Answer, frozen=True, kw_only=True):
    """One time that the other asked for shared pictures."""

    time_ms: Annotated[TimeMs, doc("When")]
    records: Annotated[Count, doc("For how many records")]
    custodians_released: Annotated[Count, doc("How many custodians then stood ready")]


class OwnShare(SharedRecords, frozen=True, kw_only=True):
    """A grant of one's own, and what became of it."""

    purpose: Annotated[str, doc("The purpose's code")]
    shared_at_ms: Annotated[TimeMs, doc("When it was shared")]
    handle: Annotated[Hex | None, doc("The other's handle; null if this wallet does not remember it")]
    name: Annotated[str | None, doc("What this wallet calls the other; null if nothing")]
    status: Annotated[str, doc("`open`, `over` (its time) or `revoked`")]
    looks: Annotated[list[GranteeLook], doc("Each time that the other asked for pictures")]
    cut: Annotated[list[Hex], doc("Ids of records of which pictures were erased since: they are shared no more")]
    erased: Annotated[list[Hex], doc("Ids of records that were erased whole since: they are shared no more")]
    confirmed_deleted: Annotated[list[Hex], doc("Ids of records whose copies the other says are deleted")]


class SharesAnswer(Answer, frozen=True, kw_only=True):
    """What one shares, and shared."""

    shares: Annotated[list[OwnShare], doc("Each grant")]


class RevokeAnswer(Answer, frozen=True, kw_only=True):
    """A grant that is ended."""

    grant_id: Annotated[Hex, doc("The grant")]
    txid: Annotated[Hex | None, doc("The transaction; null if it had been revoked before")]
    looks: Annotated[Count, doc("How often the other had asked for pictures")]
    already_ended: Annotated[bool, doc("Whether it had been revoked before")]


class HandleAnswer(Answer, frozen=True, kw_only=True):
    """One's own handle."""

    handle: Annotated[Hex, doc("The handle")]
    short: Annotated[str, doc("The same in short, with a checksum")]
    role: Annotated[str, doc("One's own role")]


class ErasureRequest(Answer, frozen=True, kw_only=True):
    """A request to erase: one for each visit, or for 64 records of it."""

    erasure_id: Annotated[Hex, doc("The request")]
    status: Annotated[str, doc("`requested` or `complete`")]
    custodians: Annotated[list[Hex], doc("Keys of the custodians that are to destroy it")]
    confirmed: Annotated[list[Hex], doc("Keys of those that have confirmed")]


class EraseAnswer(Answer, frozen=True, kw_only=True):
    """What was asked to be erased.

    `ok` is false if `--wait` waited in vain: it is asked for, and not every custodian has confirmed it.
    """

    error: Annotated[Problem | UnsetType, doc("`ERASURE_NOT_CONFIRMED`; absent unless `--wait` waited in vain")] = UNSET
    erasures: Annotated[list[ErasureRequest], doc("Each request that was made")]
    left_out_numbers: Annotated[list[Count], doc("Places, from 1, of pictures that were named and are erased already")]
    recipients: Annotated[list[OwnShare], doc("Each grant under which somebody had received it")]


class ShareNotice(Answer, frozen=True, kw_only=True):
    """What became of a record that was shared with one."""

    record_id: Annotated[Hex, doc("The record")]
    kind: Annotated[str, doc("`erased`, `pictures-erased`, `corrected`, `restricted`, `denied`, `revoked` or `ended`")]
    confirmed: Annotated[bool, doc("Whether one has said that the copies are deleted")]


class ReceivedShare(SharedRecords, frozen=True, kw_only=True):
    """A grant that one received, and what became of it."""

    purpose: Annotated[str, doc("The purpose's code")]
    shared_at_ms: Annotated[TimeMs, doc("When it was shared")]
    open: Annotated[bool, doc("Whether it can be looked at by its terms")]
    looked: Annotated[bool, doc("Whether one ever asked for its pictures")]
    to_look: Annotated[list[Hex], doc("Ids of records that can still be looked at")]
    notices: Annotated[list[ShareNotice], doc("What became of its records")]
    to_confirm: Annotated[list[Hex], doc("Ids of records whose deletion is still to be confirmed")]
    copies: Annotated[list[str], doc("Folders on this machine that still hold pictures")]


class UnreadShare(Answer, frozen=True, kw_only=True):
    """A grant that could not be read."""

    grant_id: Annotated[Hex, doc("The grant")]
    code: Annotated[str, doc("The error's code")]
    detail: Annotated[str, doc("Why, in English")]


class VisitAlarm(Answer, frozen=True, kw_only=True):
    """A visit of one's own of which something is missing or does not open."""

    visit: Annotated[Hex, doc("The visit's name: its first owner key")]
    missing_records: Annotated[Count, doc("How many records never came")]
    unreadable_records: Annotated[list[Hex], doc("Ids of records that do not open")]


class LookAtOwn(Answer, frozen=True, kw_only=True):
    """One time that somebody looked at one's own records by a share."""

    visit: Annotated[Hex, doc("The visit's name: its first owner key")]
    grant_id: Annotated[Hex, doc("The grant")]
    records: Annotated[Count, doc("At how many records")]
    purpose: Annotated[str, doc("The purpose's code")]
    time_ms: Annotated[TimeMs, doc("The block's time")]
    height: Annotated[Height, doc("The block that holds it")]


class InboxAnswer(Answer, frozen=True, kw_only=True):
    """What was shared with one, and what is wrong with one's own visits."""

    received: Annotated[list[ReceivedShare], doc("Each grant that one received")]
    unread: Annotated[list[UnreadShare], doc("Each grant that could not be read")]
    alarms: Annotated[list[VisitAlarm], doc("Each visit of one's own with something wrong")]
    reads_new: Annotated[bool, doc("Whether new grants are looked for: false if the membership ended")]
    looks: Annotated[list[LookAtOwn], doc("Each time that somebody looked at one's own records, oldest first")]
    changed_records: Annotated[list[Hex], doc("Ids of one's own records that were found changed")]


class LookAnswer(WrittenPictures, frozen=True, kw_only=True):
    """Records that were shared with one, fetched and checked."""

    records: Annotated[list[FetchedRecord], doc("Each record that was fetched")]
    restricted: Annotated[list[Hex], doc("Ids of records that are left out because their owner restricted them")]


class ConfirmDeletedAnswer(Answer, frozen=True, kw_only=True):
    """Copies that the owner was told are deleted."""

    records: Annotated[list[Hex], doc("Ids of records of which it was said")]
    deleted: Annotated[list[str], doc("Folders that were deleted")]
    kept: Annotated[list[str], doc("Files in them that `look` did not write, and that stay")]


ANSWERS: AnswersByCommand = {
    "wallet erase": EraseAnswer,
    "wallet share": ShareAnswer,
    "wallet shares": SharesAnswer,
    "wallet revoke": RevokeAnswer,
    "wallet handle": HandleAnswer,
    "wallet inbox": InboxAnswer,
    "wallet look": LookAnswer,
    "wallet confirm-deleted": ConfirmDeletedAnswer,
}
