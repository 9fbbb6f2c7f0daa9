"""What `blockrobot card` and `roster` answer with `--json`."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Hex, doc


class CardIssueAnswer(Answer, frozen=True, kw_only=True):
    """A card that was issued."""

    role: Annotated[str, doc("What the card registers")]
    code: Annotated[str, doc("The enrolment code, shown this once; empty with --out")]
    out: Annotated[str, doc("The file with the card; empty without --out")]
    replaced: Annotated[bool, doc("Whether the tag had a card before: destroy it, its holder is on no roster")]


class CardRevokeAnswer(Answer, frozen=True, kw_only=True):
    """A membership that was revoked."""

    txid: Annotated[Hex, doc("The revocation")]
    role: Annotated[str, doc("Whose membership it was")]


class CardNameAnswer(Answer, frozen=True, kw_only=True):
    """A robot that was named."""

    txid: Annotated[Hex, doc("The transaction that named it")]
    robot: Annotated[Hex, doc("The robot's key")]
    name: Annotated[str, doc("Its name")]
    place: Annotated[str, doc("Where it is; may be empty")]


class CardForgetAnswer(Answer, frozen=True, kw_only=True):
    """Cards that were forgotten."""

    forgotten: Annotated[Count, doc("How many cards are off the list")]


class RosterMakeAnswer(Answer, frozen=True, kw_only=True):
    """A roster that was written."""

    rows: Annotated[Count, doc("How many people are on it")]
    out: Annotated[str, doc("The file")]
    superseded: Annotated[list[Hex], doc("Members who are not on it: they registered with a card that was replaced")]


ANSWERS: AnswersByCommand = {
    "card issue": CardIssueAnswer,
    "card revoke": CardRevokeAnswer,
    "card name": CardNameAnswer,
    "card forget": CardForgetAnswer,
    "roster make": RosterMakeAnswer,
}
