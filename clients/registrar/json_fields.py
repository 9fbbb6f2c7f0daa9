"""Which fields `blockrobot card` and `roster` answer with `--json`."""

from __future__ import annotations

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind

ANSWERS: tuple[CommandAnswer, ...] = (
    CommandAnswer(
        ("card issue",),
        (
            Field("role", Kind.TEXT, "what the card registers"),
            Field("code", Kind.TEXT, "the enrolment code, shown this once; empty with --out"),
            Field("out", Kind.TEXT, "the file with the card; empty without --out"),
            Field("replaced", Kind.BOOL, "whether the tag had a card before, which is on no roster any more"),
        ),
    ),
    CommandAnswer(
        ("card revoke",),
        (Field("txid", Kind.HEX, "the revocation"), Field("role", Kind.TEXT, "whose membership it was")),
    ),
    CommandAnswer(
        ("card name",),
        (
            Field("txid", Kind.HEX, "the transaction that named it"),
            Field("robot", Kind.HEX, "the robot's key"),
            Field("name", Kind.TEXT, "its name"),
            Field("place", Kind.TEXT, "where it is; may be empty"),
        ),
    ),
    CommandAnswer(("card forget",), (Field("forgotten", Kind.COUNT, "how many cards are off the list"),)),
    CommandAnswer(
        ("roster make",),
        (Field("rows", Kind.COUNT, "how many people are on it"), Field("out", Kind.TEXT, "the file")),
    ),
)
"""What these commands answer."""
