"""What `blockrobot officer` answers with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, UnsetType

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Height, Hex, Ms, TimeMs, doc


class BreachAssessed(Answer, frozen=True, kw_only=True):
    """The last assessment of a breach."""

    time: Annotated[TimeMs, doc("When")]
    officer: Annotated[Hex, doc("The officer's member key")]
    reason: Annotated[str, doc("The reason's code")]


class BreachNotice(Answer, frozen=True, kw_only=True):
    """That somebody was notified of a breach."""

    time: Annotated[TimeMs, doc("When")]
    officer: Annotated[Hex, doc("The officer's member key")]
    reason: Annotated[str, doc("Why so late, a code; empty if it was in time")]
    late: Annotated[bool, doc("Whether the 72 hours were over")]


class BreachNotices(Answer, frozen=True, kw_only=True):
    """Who was notified of a breach."""

    authority: Annotated[BreachNotice | UnsetType, doc("That the authority was; absent until it is told")] = UNSET
    subjects: Annotated[BreachNotice | UnsetType, doc("That the people were; absent until they are told")] = UNSET


class BreachClosed(Answer, frozen=True, kw_only=True):
    """How a breach ended."""

    time: Annotated[TimeMs, doc("When")]
    officer: Annotated[Hex, doc("The officer's member key")]
    outcome: Annotated[str, doc("`erased` or `released`")]
    reason: Annotated[str, doc("The reason's code")]


class BreachAnswer(Answer, frozen=True, kw_only=True):
    """A breach: a visit that was denied."""

    breach_id: Annotated[Hex, doc("The breach")]
    kind: Annotated[str, doc("`wrong-person`")]
    organisation: Annotated[str, doc("Whose robot it was")]
    robot: Annotated[Hex, doc("The robot's key")]
    visit: Annotated[Hex, doc("The visit that was denied")]
    status: Annotated[str, doc("`opened`, `assessed`, `notified` or `closed`")]
    risk: Annotated[str | None, doc("`none`, `risk` or `high`; null until it is assessed")]
    opened_ms: Annotated[TimeMs, doc("When the visit was denied")]
    due_ms: Annotated[TimeMs, doc("When the 72 hours are over")]
    left_ms: Annotated[Ms, doc("What is left of them by the chain's clock; negative once they are over")]
    overdue: Annotated[bool, doc("Whether the authority should have been told, and was not")]
    assessed: Annotated[BreachAssessed | None, doc("The last assessment; null until there is one")]
    notified: Annotated[BreachNotices, doc("Who was told")]
    closed: Annotated[BreachClosed | None, doc("How it ended; null until it is closed")]


class BreachesAnswer(Answer, frozen=True, kw_only=True):
    """Breaches: those that are open, or all."""

    breaches: Annotated[list[BreachAnswer], doc("Each breach")]


class BreachCloseAnswer(BreachAnswer, frozen=True, kw_only=True):
    """A breach that was closed."""

    erasing: Annotated[Count, doc("How many records are being erased")]


class CorrectionFile(Answer, frozen=True, kw_only=True):
    """What a file with a correction holds."""

    kind: Annotated[str, doc("`attribution` or `metadata`")]
    text: Annotated[str, doc("What is right")]
    salt: Annotated[Hex, doc("What its seal on the chain was made with")]
    visit: Annotated[Hex, doc("The visit's name")]
    record_ids: Annotated[list[Hex], doc("Ids of the records that are meant; none: the whole visit")]


class CorrectionAnswer(Answer, frozen=True, kw_only=True):
    """A correction that the chain confirms."""

    number: Annotated[Count, doc("Its number at that visit, from 0")]
    txid: Annotated[Hex, doc("The transaction")]
    height: Annotated[Height, doc("The block that holds it")]
    time_ms: Annotated[TimeMs, doc("That block's time")]
    correction: Annotated[CorrectionFile, doc("What the file holds")]


class VisitInSpan(Answer, frozen=True, kw_only=True):
    """A visit in the span of a lost key."""

    visit: Annotated[Hex, doc("The visit's name")]
    bucket_ms: Annotated[TimeMs, doc("The five minutes in which it began")]
    erasable_records: Annotated[Count, doc("How many records would be erased")]
    restricted_records: Annotated[Count, doc("How many are restricted")]
    denied: Annotated[bool, doc("Whether it was denied")]


class LostKeysPreviewAnswer(Answer, frozen=True, kw_only=True):
    """What an erasure for a lost key would touch."""

    robot: Annotated[Hex, doc("The robot's key")]
    from_ms: Annotated[TimeMs, doc("The span's beginning")]
    until_ms: Annotated[TimeMs, doc("Its end")]
    visits: Annotated[Count, doc("How many visits would be touched")]
    records: Annotated[Count, doc("How many records would be erased")]
    restricted_visits: Annotated[Count, doc("Of how many visits records stay, since their owner restricted them")]
    denied_visits: Annotated[Count, doc("How many visits stay, since they were denied")]
    visits_in_span: Annotated[list[VisitInSpan], doc("Each visit of the span")]


class LostKeysProposalAnswer(Answer, frozen=True, kw_only=True):
    """A proposal to erase what a lost key owns."""

    proposal_id: Annotated[Hex, doc("The proposal")]
    status: Annotated[str, doc("`proposed`, `approved`, `stopped` or `lapsed`")]
    organisation: Annotated[str, doc("Whose robot it was")]
    robot: Annotated[Hex, doc("The robot's key")]
    from_ms: Annotated[TimeMs, doc("The span's beginning")]
    until_ms: Annotated[TimeMs, doc("Its end")]
    reason: Annotated[str, doc("The reason's code")]
    visits_max: Annotated[Count, doc("How many visits may go at most")]
    visits: Annotated[Count, doc("Of how many visits erasure was ordered so far")]
    records: Annotated[Count, doc("Of how many records")]
    proposer: Annotated[Hex, doc("The first officer's member key")]
    approver: Annotated[Hex | None, doc("The second officer's member key; null until it is approved")]
    proposed_ms: Annotated[TimeMs, doc("When it was proposed")]
    approved_ms: Annotated[TimeMs | None, doc("When it was approved; null until it is")]
    ends_ms: Annotated[TimeMs, doc("Until when the next step may be taken")]


class LostKeysDecisionAnswer(LostKeysProposalAnswer, frozen=True, kw_only=True):
    """A proposal that was made or approved."""

    preview: Annotated[LostKeysPreviewAnswer, doc("What it would touch")]


class LostKeysEraseAnswer(LostKeysProposalAnswer, frozen=True, kw_only=True):
    """A proposal under which erasure was ordered."""

    erasure_ids: Annotated[list[Hex], doc("Requests for erasure that were made now")]
    ordered_visits: Annotated[Count, doc("Of how many visits")]
    ordered_records: Annotated[Count, doc("Of how many records")]
    kept_visits: Annotated[Count, doc("How many visits stay in whole or in part: restricted, or denied")]
    left_visits: Annotated[Count, doc("How many visits are more than was approved, and left")]


class LostKeysListAnswer(Answer, frozen=True, kw_only=True):
    """Proposals, also those that are over."""

    proposals: Annotated[list[LostKeysProposalAnswer], doc("Each proposal")]


ANSWERS: AnswersByCommand = {
    "officer breaches": BreachesAnswer,
    "officer assess": BreachAnswer,
    "officer notify": BreachAnswer,
    "officer close": BreachCloseAnswer,
    "officer correction": CorrectionAnswer,
    "officer lost-keys preview": LostKeysPreviewAnswer,
    "officer lost-keys propose": LostKeysDecisionAnswer,
    "officer lost-keys approve": LostKeysDecisionAnswer,
    "officer lost-keys erase": LostKeysEraseAnswer,
    "officer lost-keys list": LostKeysListAnswer,
    "officer lost-keys stop": LostKeysProposalAnswer,
}
