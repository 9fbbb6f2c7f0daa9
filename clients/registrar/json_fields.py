"""Which fields `blockrobot card` and `roster` answer with `--json`."""

from __future__ import annotations

from clients.sdk.json_fields import CommandAnswer, Field, Kind

ANSWERS: tuple[CommandAnswer, ...] = (
    CommandAnswer(
        ("card issue",),
        (
            Field("role", Kind.TEXT, "what the card registers"),
            Field("code", Kind.TEXT, "the enrolment code, shown this once"),
        ),
    ),
    CommandAnswer(
        ("roster make",),
        (Field("rows", Kind.COUNT, "how many people are on it"), Field("out", Kind.TEXT, "the file")),
    ),
)
"""What these commands answer."""
