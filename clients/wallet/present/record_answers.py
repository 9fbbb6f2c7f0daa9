"""What `blockrobot wallet` answers with `--json` of records: listed, fetched, checked, exported, erased."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Hex, doc


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
    out: Annotated[None, doc("No folder: nothing is written; always null")] = None


ANSWERS: AnswersByCommand = {"wallet view": ViewAnswer, "wallet verify": VerifyAnswer}
