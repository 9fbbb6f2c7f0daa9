"""`--json` fields of `officer mandates` and `wallet mandates`."""

from __future__ import annotations

from typing import Any

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind
from clients.wallet.ledger.mandates import Mandate

SPOKEN_FOR = (
    Field("for", Kind.HEX, "the handle of the person for whom it was said", null="if for oneself"),
    Field("mandate_id", Kind.HEX, "the mandate under which it was said", null="if for oneself"),
)

_MANDATE = (
    Field("mandate_id", Kind.HEX, "the mandate"),
    Field("status", Kind.TEXT, "`proposed`, `approved`, `active`, `resting`, `ended` or `lapsed`"),
    Field("organisation", Kind.TEXT, "whose officers give it"),
    Field("represented", Kind.HEX, "the handle of the person for whom it is"),
    Field("representative", Kind.HEX, "the handle of who acts for that person"),
    Field("acts", Kind.TEXTS, "what it is for: `consent`"),
    Field("papers", Kind.HEX, "the salted hash of the reason and the papers"),
    Field("until_ms", Kind.TIME_MS, "when it ends"),
    Field("proposer", Kind.HEX, "the first officer's member key"),
    Field("approver", Kind.HEX, "the second officer's member key", null="until it is approved"),
    Field("proposed_ms", Kind.TIME_MS, "when it was proposed"),
    Field("approved_ms", Kind.TIME_MS, "when it was approved", null="until it is"),
    Field("accepted_ms", Kind.TIME_MS, "when the representative accepted it", null="until then"),
    Field("ends_ms", Kind.TIME_MS, "until when the next of the two others may agree"),
    Field("ended_ms", Kind.TIME_MS, "when it was ended", null="if nobody ended it"),
    Field("ended_by", Kind.HEX, "the member key of who ended it", null="if nobody did"),
)

_TRAIL = Field(
    "trail",
    Kind.ROWS,
    "what was done under it, in order",
    fields=(
        Field("kind", Kind.TEXT, "`given`, `refused`, `withdrawn` or `objected`"),
        Field("time_ms", Kind.TIME_MS, "when"),
        Field("height", Kind.HEIGHT, "the block that holds it"),
        Field("txid", Kind.HEX, "the transaction"),
        Field("purposes", Kind.TEXTS, "purposes' codes; none: all"),
        Field("sensors", Kind.TEXTS, "sensors' codes; none: all"),
        Field("period_until_ms", Kind.TIME_MS, "until when, of a giving", null="of a no"),
    ),
)

_ROW = (*_MANDATE, Field("role", Kind.TEXT, "`representative` or `represented`: what you are in it"), _TRAIL)

OFFICER_ANSWERS: tuple[CommandAnswer, ...] = (
    CommandAnswer(
        ("officer mandates propose",), (*_MANDATE, Field("receipt", Kind.TEXT, "the file that was written: keep it"))
    ),
    CommandAnswer(("officer mandates approve", "officer mandates end"), _MANDATE),
    CommandAnswer(("officer mandates list",), (Field("mandates", Kind.ROWS, "each mandate", fields=_MANDATE),)),
)
"""What `officer mandates` answers."""

WALLET_ANSWERS: tuple[CommandAnswer, ...] = (
    CommandAnswer(("wallet mandates list",), (Field("mandates", Kind.ROWS, "each mandate", fields=_ROW),)),
    CommandAnswer(("wallet mandates accept", "wallet mandates end"), _MANDATE),
)
"""What `wallet mandates` answers."""


def mandate_json(mandate: Mandate) -> dict[str, Any]:
    state = mandate.state
    return {
        "mandate_id": mandate.mandate_id.hex(),
        "status": mandate.status,
        "organisation": state.org,
        "represented": state.handle.hex(),
        "representative": state.representative.hex(),
        "acts": state.acts,
        "papers": state.papers.hex(),
        "until_ms": state.until_ms,
        "proposer": state.proposer.hex(),
        "approver": state.approver.hex() or None,
        "proposed_ms": state.proposed_ms,
        "approved_ms": state.approved_ms or None,
        "accepted_ms": state.accepted_ms or None,
        "ends_ms": state.ends_ms,
        "ended_ms": state.ended_ms or None,
        "ended_by": state.ended_by.hex() or None,
    }
