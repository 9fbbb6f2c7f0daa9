"""What `blockrobot custody hunt` answers with `--json`."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Hex, doc


class FoundRemains(Answer, frozen=True, kw_only=True):
    """A part of a record that was found."""

    record: Annotated[Hex, doc("The record")]
    place: Annotated[str, doc("Where")]
    what: Annotated[str, doc("Which part of it")]
    count: Annotated[Count, doc("How often it is there")]
    allowed: Annotated[bool, doc("Whether it may be there")]
    why: Annotated[str, doc("Why it may, and until when; empty if it must not be there")]


class CustodyHuntAnswer(Answer, frozen=True, kw_only=True):
    """What is left of records. `ok` is false if something must not be there, was not searched, or not compared."""

    records: Annotated[dict[str, str], doc("The state of each record on the chain, by its id")]
    found: Annotated[list[FoundRemains], doc("What was found")]
    not_compared: Annotated[list[Hex], doc("Records of which nothing is known that could be searched for")]
    searched_for: Annotated[dict[str, Count], doc("How many pieces of each kind were searched for")]
    files_count: Annotated[Count, doc("How many files were searched")]
    documents_count: Annotated[Count, doc("How many documents of databases")]
    size_bytes: Annotated[Count, doc("How much that is")]
    unread: Annotated[list[str], doc("Places that could not be searched")]


ANSWERS: AnswersByCommand = {"custody hunt": CustodyHuntAnswer}
