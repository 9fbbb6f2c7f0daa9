"""What `blockrobot wallet` answers with `--json` of registering, notices and consent."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import UNSET, UnsetType

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Height, Hex, TimeMs, doc
from clients.wallet.answers.mandate_answers import SpokenFor


class NoticeAnswer(Answer, frozen=True, kw_only=True):
    """What an organisation tells people about their data."""

    organisation: Annotated[str, doc("Whose words these are")]
    version: Annotated[Count, doc("The version in force; 0: nothing is published")]
    hash: Annotated[Hex | None, doc("The hash that stands on the chain; null if nothing is published")]
    published_at_ms: Annotated[TimeMs | None, doc("When it was published; null if nothing is")]
    consented_version: Annotated[
        Count | None, doc("The version in force at the last consent; null if that is this one, or none")
    ]
    changes: Annotated[list[str], doc("What changed since that version, a sentence each")]
    lines: Annotated[list[str], doc("The notice, a line each")]


class FetchedReceipt(Answer, frozen=True, kw_only=True):
    """A consent receipt that was fetched."""

    signed_by: Annotated[str, doc("The node that signed it")]
    notice_version: Annotated[Count | None, doc("The notice it is about; null if none was published")]


class RegisterAnswer(Answer, frozen=True, kw_only=True):
    """A wallet that is registered."""

    notice: Annotated[NoticeAnswer, doc("What the organisation that issued the card tells")]
    receipt: Annotated[
        FetchedReceipt | UnsetType | None,
        doc("The consent receipt; null if it could not be had yet; absent if nothing was consented to"),
    ] = UNSET
    receipt_error: Annotated[
        str | UnsetType | None,
        doc("The code of what was in its way; null if the receipt is here; absent if nothing was consented to"),
    ] = UNSET
    txid: Annotated[Hex, doc("The registration; empty if this wallet had been registered before")]
    member: Annotated[Hex, doc("The member key")]
    purposes: Annotated[list[str], doc("What was consented to")]


class ConsentWordAnswer(SpokenFor, frozen=True, kw_only=True):
    """A word on consent that is final."""

    txid: Annotated[Hex, doc("The transaction")]
    height: Annotated[Height, doc("The block that holds it")]
    from_height: Annotated[Height, doc("From which block on it holds")]
    count: Annotated[Count, doc("How many choices it changed")]
    status: Annotated[str, doc("`given`, `refused` or `withdrawn`")]
    purposes: Annotated[list[str], doc("Purposes' codes; none in a no: all")]
    sensors: Annotated[list[str], doc("Sensors' codes; none in a no: all")]
    receipt: Annotated[
        FetchedReceipt | None, doc("The consent receipt; null if it could not be had yet, or none is due")
    ]
    receipt_error: Annotated[
        str | None, doc("The code of what was in its way; null if the receipt is here, or none is due")
    ]


class ConsentGiveAnswer(ConsentWordAnswer, frozen=True, kw_only=True):
    """Consent that is final."""

    period_from_ms: Annotated[TimeMs | None, doc("Not before; null if no beginning was named")]
    period_until_ms: Annotated[TimeMs | None, doc("Not after; null if no end was named")]
    notice: Annotated[NoticeAnswer | None, doc("The notice; null if this wallet had shown it before")]


class ConsentChoice(Answer, frozen=True, kw_only=True):
    """The last word on a purpose and a sensor."""

    purpose: Annotated[str, doc("The purpose's code")]
    sensor: Annotated[str, doc("The sensor's code")]
    holds_now: Annotated[bool, doc("Whether it allows recording at that block")]
    status: Annotated[str, doc("`given`, `refused` or `withdrawn`")]
    from_height: Annotated[Height, doc("From which block on it holds")]
    since_ms: Annotated[TimeMs, doc("When it was said")]
    period_from_ms: Annotated[TimeMs | None, doc("Not before; null if there is no beginning")]
    period_until_ms: Annotated[TimeMs | None, doc("Not after; null if there is no end")]
    mandate_id: Annotated[Hex | None, doc("Under which mandate it was said; null if by the person")]


class ConsentListAnswer(Answer, frozen=True, kw_only=True):
    """What the person said about being recorded."""

    height: Annotated[Height, doc("The block as of which it is proved")]
    choices: Annotated[list[ConsentChoice], doc("The last word on each purpose and sensor")]


class ReceiptNotHad(Answer, frozen=True, kw_only=True):
    """A word whose receipt could not be had."""

    txid: Annotated[Hex, doc("The transaction")]
    code: Annotated[str, doc("Why not: the error's code")]


class ConsentReceiptsAnswer(Answer, frozen=True, kw_only=True):
    """Consent receipts, each checked anew."""

    receipts: Annotated[list[dict[str, Any]], doc("Each receipt as it was signed: docs/reference/formats.md")]
    missing: Annotated[list[ReceiptNotHad], doc("Words whose receipt could not be had")]
    file: Annotated[str | None, doc("What `--out` wrote; null if nothing was written")]


ANSWERS: AnswersByCommand = {
    "wallet register": RegisterAnswer,
    "wallet notice": NoticeAnswer,
    "wallet consent give": ConsentGiveAnswer,
    "wallet consent refuse": ConsentWordAnswer,
    "wallet consent withdraw": ConsentWordAnswer,
    "wallet consent list": ConsentListAnswer,
    "wallet consent receipts": ConsentReceiptsAnswer,
}
