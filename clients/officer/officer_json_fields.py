"""Which fields `blockrobot officer` answers with `--json`."""

from __future__ import annotations

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind

_REASON = Field("reason", Kind.TEXT, "the reason's code")
_BY = (Field("time", Kind.TIME_MS, "when"), Field("officer", Kind.HEX, "the officer's member key"))
_TOLD = (
    *_BY,
    Field("reason", Kind.TEXT, "why so late, a code; empty if it was in time"),
    Field("late", Kind.BOOL, "whether the 72 hours were over"),
)

_BREACH = (
    Field("breach_id", Kind.HEX, "the breach"),
    Field("kind", Kind.TEXT, "`wrong-person`"),
    Field("organisation", Kind.TEXT, "whose robot it was"),
    Field("robot", Kind.HEX, "the robot's key"),
    Field("visit", Kind.HEX, "the visit that was denied"),
    Field("status", Kind.TEXT, "`opened`, `assessed`, `notified` or `closed`"),
    Field("risk", Kind.TEXT, "`none`, `risk` or `high`", null="until it is assessed"),
    Field("opened_ms", Kind.TIME_MS, "when the visit was denied"),
    Field("due_ms", Kind.TIME_MS, "when the 72 hours are over"),
    Field("left_ms", Kind.MS, "what is left of them by the chain's clock; negative once they are over"),
    Field("overdue", Kind.BOOL, "whether the authority should have been told, and was not"),
    Field("assessed", Kind.OBJECT, "the last assessment", null="until there is one", fields=(*_BY, _REASON)),
    Field(
        "notified",
        Kind.OBJECT,
        "who was told",
        fields=(
            Field("authority", Kind.OBJECT, "that the authority was", absent="until it is told", fields=_TOLD),
            Field("subjects", Kind.OBJECT, "that the people were", absent="until they are told", fields=_TOLD),
        ),
    ),
    Field(
        "closed",
        Kind.OBJECT,
        "how it ended",
        null="until it is closed",
        fields=(*_BY, Field("outcome", Kind.TEXT, "`erased` or `released`"), _REASON),
    ),
)

_SPAN = (
    Field("robot", Kind.HEX, "the robot's key"),
    Field("from_ms", Kind.TIME_MS, "the span's beginning"),
    Field("until_ms", Kind.TIME_MS, "its end"),
)

_PREVIEW = (
    *_SPAN,
    Field("visits", Kind.COUNT, "how many visits would be touched"),
    Field("records", Kind.COUNT, "how many records would be erased"),
    Field("restricted_visits", Kind.COUNT, "of how many visits records stay, since their owner restricted them"),
    Field("denied_visits", Kind.COUNT, "how many visits stay, since they were denied"),
    Field(
        "visits_in_span",
        Kind.ROWS,
        "each visit of the span",
        fields=(
            Field("visit", Kind.HEX, "the visit's name"),
            Field("bucket_ms", Kind.TIME_MS, "the five minutes in which it began"),
            Field("erasable_records", Kind.COUNT, "how many records would be erased"),
            Field("restricted_records", Kind.COUNT, "how many are restricted"),
            Field("denied", Kind.BOOL, "whether it was denied"),
        ),
    ),
)

_PROPOSAL = (
    Field("proposal_id", Kind.HEX, "the proposal"),
    Field("status", Kind.TEXT, "`proposed`, `approved`, `stopped` or `lapsed`"),
    Field("organisation", Kind.TEXT, "whose robot it was"),
    *_SPAN,
    _REASON,
    Field("visits_max", Kind.COUNT, "how many visits may go at most"),
    Field("visits", Kind.COUNT, "of how many visits erasure was ordered so far"),
    Field("records", Kind.COUNT, "of how many records"),
    Field("proposer", Kind.HEX, "the first officer's member key"),
    Field("approver", Kind.HEX, "the second officer's member key", null="until it is approved"),
    Field("proposed_ms", Kind.TIME_MS, "when it was proposed"),
    Field("approved_ms", Kind.TIME_MS, "when it was approved", null="until it is"),
    Field("ends_ms", Kind.TIME_MS, "until when the next step may be taken"),
)

_LOST_KEYS = (
    CommandAnswer(("officer lost-keys preview",), _PREVIEW),
    CommandAnswer(
        ("officer lost-keys propose", "officer lost-keys approve"),
        (*_PROPOSAL, Field("preview", Kind.OBJECT, "what it would touch", fields=_PREVIEW)),
    ),
    CommandAnswer(
        ("officer lost-keys erase",),
        (
            *_PROPOSAL,
            Field("erasure_ids", Kind.HEXES, "requests for erasure that were made now"),
            Field("ordered_visits", Kind.COUNT, "of how many visits"),
            Field("ordered_records", Kind.COUNT, "of how many records"),
            Field("kept_visits", Kind.COUNT, "how many visits stay in whole or in part: restricted, or denied"),
            Field("left_visits", Kind.COUNT, "how many visits are more than was approved, and left"),
        ),
    ),
    CommandAnswer(("officer lost-keys list",), (Field("proposals", Kind.ROWS, "each proposal", fields=_PROPOSAL),)),
    CommandAnswer(("officer lost-keys stop",), _PROPOSAL),
)

_BREACHES = (
    CommandAnswer(("officer breaches",), (Field("breaches", Kind.ROWS, "each breach", fields=_BREACH),)),
    CommandAnswer(("officer assess", "officer notify"), _BREACH),
    CommandAnswer(
        ("officer close",),
        (*_BREACH, Field("erasing", Kind.COUNT, "how many records are being erased")),
    ),
    CommandAnswer(
        ("officer correction",),
        (
            Field("number", Kind.COUNT, "its number at that visit, from 0"),
            Field("txid", Kind.HEX, "the transaction"),
            Field("height", Kind.HEIGHT, "the block that holds it"),
            Field("time_ms", Kind.TIME_MS, "that block's time"),
            Field(
                "correction",
                Kind.OBJECT,
                "what the file holds",
                fields=(
                    Field("kind", Kind.TEXT, "`attribution` or `metadata`"),
                    Field("text", Kind.TEXT, "what is right"),
                    Field("salt", Kind.HEX, "what its seal on the chain was made with"),
                    Field("visit", Kind.HEX, "the visit's name"),
                    Field("record_ids", Kind.HEXES, "ids of the records that are meant; none: the whole visit"),
                ),
            ),
        ),
    ),
)

ANSWERS: tuple[CommandAnswer, ...] = (*_BREACHES, *_LOST_KEYS)
"""What these commands answer."""
