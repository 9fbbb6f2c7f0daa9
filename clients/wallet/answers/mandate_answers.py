"""What `blockrobot wallet mandates` and `blockrobot officer mandates` answer with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import field

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Height, Hex, TimeMs, doc
from clients.wallet.ledger.mandates import Mandate


class SpokenFor(Answer, frozen=True, kw_only=True):
    """For whom something was said."""

    for_: Annotated[Hex | None, doc("The handle of the person for whom it was said; null if for oneself")] = field(
        name="for"
    )
    mandate_id: Annotated[Hex | None, doc("The mandate under which it was said; null if for oneself")]


class MandateAnswer(Answer, frozen=True, kw_only=True):
    """A mandate, or a proposal of one."""

    mandate_id: Annotated[Hex, doc("The mandate")]
    status: Annotated[str, doc("`proposed`, `approved`, `active`, `resting`, `ended` or `lapsed`")]
    organisation: Annotated[str, doc("Whose officers give it")]
    represented: Annotated[Hex, doc("The handle of the person for whom it is")]
    representative: Annotated[Hex, doc("The handle of who acts for that person")]
    acts: Annotated[list[str], doc("What it is for: `consent`")]
    papers: Annotated[Hex, doc("The salted hash of the reason and the papers")]
    until_ms: Annotated[TimeMs, doc("When it ends")]
    proposer: Annotated[Hex, doc("The first officer's member key")]
    approver: Annotated[Hex | None, doc("The second officer's member key; null until it is approved")]
    proposed_ms: Annotated[TimeMs, doc("When it was proposed")]
    approved_ms: Annotated[TimeMs | None, doc("When it was approved; null until it is")]
    accepted_ms: Annotated[TimeMs | None, doc("When the representative accepted it; null until then")]
    ends_ms: Annotated[TimeMs, doc("Until when the next of the two others may agree")]
    ended_ms: Annotated[TimeMs | None, doc("When it was ended; null if nobody ended it")]
    ended_by: Annotated[Hex | None, doc("The member key of who ended it; null if nobody did")]


class MandateProposalAnswer(MandateAnswer, frozen=True, kw_only=True):
    """A mandate that was proposed."""

    receipt: Annotated[str, doc("The file that was written: keep it")]


class MandatesAnswer(Answer, frozen=True, kw_only=True):
    """Mandates and proposals: those that are open, or all."""

    mandates: Annotated[list[MandateAnswer], doc("Each mandate")]


class MandateAct(Answer, frozen=True, kw_only=True):
    """What was done under a mandate."""

    kind: Annotated[str, doc("`given`, `refused`, `withdrawn` or `objected`")]
    time_ms: Annotated[TimeMs, doc("When")]
    height: Annotated[Height, doc("The block that holds it")]
    txid: Annotated[Hex, doc("The transaction")]
    purposes: Annotated[list[str], doc("Purposes' codes; none: all")]
    sensors: Annotated[list[str], doc("Sensors' codes; none: all")]
    period_until_ms: Annotated[TimeMs | None, doc("Until when consent was given; null unless it was `given`")]


class OwnMandate(MandateAnswer, frozen=True, kw_only=True):
    """A mandate by which one is represented, or represents somebody."""

    role: Annotated[str, doc("`representative` or `represented`: what you are in it")]
    trail: Annotated[list[MandateAct], doc("What was done under it, in order")]


class OwnMandatesAnswer(Answer, frozen=True, kw_only=True):
    """Who acts for you, and for whom you act."""

    mandates: Annotated[list[OwnMandate], doc("Each mandate")]


OFFICER_ANSWERS: AnswersByCommand = {
    "officer mandates propose": MandateProposalAnswer,
    "officer mandates approve": MandateAnswer,
    "officer mandates end": MandateAnswer,
    "officer mandates list": MandatesAnswer,
}

WALLET_ANSWERS: AnswersByCommand = {
    "wallet mandates list": OwnMandatesAnswer,
    "wallet mandates accept": MandateAnswer,
    "wallet mandates end": MandateAnswer,
}


def mandate_answer(mandate: Mandate) -> MandateAnswer:
    state = mandate.state
    return MandateAnswer(
        mandate_id=mandate.mandate_id.hex(),
        status=mandate.status,
        organisation=state.org,
        represented=state.handle.hex(),
        representative=state.representative.hex(),
        acts=state.acts,
        papers=state.papers.hex(),
        until_ms=state.until_ms,
        proposer=state.proposer.hex(),
        approver=state.approver.hex() or None,
        proposed_ms=state.proposed_ms,
        approved_ms=state.approved_ms or None,
        accepted_ms=state.accepted_ms or None,
        ends_ms=state.ends_ms,
        ended_ms=state.ended_ms or None,
        ended_by=state.ended_by.hex() or None,
    )
