"""What `blockrobot wallet` answers with `--json` of rights: restrict, lift, object, correct, deny."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Height, Hex, TimeMs, doc
from clients.wallet.answers.mandate_answers import SpokenFor


class VisitStatement(Answer, frozen=True, kw_only=True):
    """What was said of one visit."""

    visit: Annotated[Hex, doc("The visit's name: its first owner key")]
    records: Annotated[list[Hex], doc("Ids of the records that are meant; none: the whole visit")]
    txid: Annotated[Hex, doc("The transaction")]
    height: Annotated[Height, doc("The block that holds it")]
    time_ms: Annotated[TimeMs, doc("That block's time")]


class RestrictedVisit(VisitStatement, frozen=True, kw_only=True):
    """A visit, or records of it, that were restricted."""

    kept_until_ms: Annotated[TimeMs | None, doc("Until when it is kept beyond its time; null if it is not")]


class RestrictAnswer(Answer, frozen=True, kw_only=True):
    """What was restricted."""

    ground: Annotated[str, doc("Why: `accuracy`, `unlawful`, `legal-claim` or `objection`")]
    restricted: Annotated[list[RestrictedVisit], doc("Each visit of which it was said")]


class LiftAnswer(Answer, frozen=True, kw_only=True):
    """Restrictions that were lifted."""

    lifted: Annotated[list[VisitStatement], doc("Each visit of which it was said")]


class ObjectAnswer(SpokenFor, frozen=True, kw_only=True):
    """An objection to purposes."""

    purposes: Annotated[list[str], doc("Purposes' codes")]
    from_height: Annotated[Height, doc("From which block on nothing is recorded for them")]
    visits: Annotated[list[VisitStatement], doc("Each past visit that was told")]


class CorrectAnswer(VisitStatement, frozen=True, kw_only=True):
    """A correction that stands beside a visit."""

    kind: Annotated[str, doc("`attribution` or `metadata`")]
    number: Annotated[Count, doc("Its number at that visit, from 0")]
    out: Annotated[str | None, doc("The file to hand on; null without `--out`")]


class WrongPersonAnswer(VisitStatement, frozen=True, kw_only=True):
    """A visit that was denied."""

    breach_id: Annotated[Hex, doc("The breach that officers find")]
    organisation: Annotated[str, doc("Whose robot it was")]
    due_ms: Annotated[TimeMs, doc("When the 72 hours are over")]


ANSWERS: AnswersByCommand = {
    "wallet restrict": RestrictAnswer,
    "wallet lift": LiftAnswer,
    "wallet object": ObjectAnswer,
    "wallet correct": CorrectAnswer,
    "wallet wrong-person": WrongPersonAnswer,
}
