"""Codes, sentences and bounds of rights and of erasures for lost keys; same as contracts `rights` and `officers`."""

from __future__ import annotations

import msgspec

from consensus.primitives.hashing import tagged_hash

KEEP_MS = 366 * 24 * 3600 * 1000
"""How long a restriction for a claim keeps records beyond their expiry, unless it is said again."""
BREACH_NOTIFY_MS = 72 * 3600 * 1000
"""Art. 33(1): the authority is told within 72 hours."""
CORRECTION_SALT_BYTES = 32
CORRECTION_MAX_BYTES = 4096
LOST_KEY_SPAN_MAX_MS = 3600 * 1000
"""How long the span of a lost key may be: others whom the robot met in it lose their visits too."""
LOST_KEY_VISITS_MAX_COUNT = 64
LOST_KEY_APPROVE_MS = 3 * 24 * 3600 * 1000
"""How long a proposal waits for a second officer."""
LOST_KEY_CARRY_OUT_MS = 7 * 24 * 3600 * 1000
"""How long an approved proposal may be carried out: a robot's spool may deliver records a day late."""

GROUNDS: dict[str, str] = {
    "accuracy": "What was recorded is not right, and that is being checked (Art. 18(1)(a)).",
    "unlawful": "It should not have been recorded, but is to be kept (Art. 18(1)(b)).",
    "legal-claim": "The person needs it for a claim of their own (Art. 18(1)(c)).",
    "objection": "The person objected, and that is being checked (Art. 18(1)(d)).",
}
KEEPING_GROUNDS = ("legal-claim", "unlawful")
OWN_PURPOSES = ("complaint", "own-access")
CORRECTIONS: dict[str, str] = {
    "attribution": "Who is to be seen.",
    "metadata": "When, where or by which sensor it was recorded.",
}
RISKS: dict[str, str] = {
    "none": "A risk to people is unlikely: nobody has to be told (Art. 33(1)).",
    "risk": "There is a risk to people: the authority is told (Art. 33).",
    "high": "There is a high risk to people: the authority and the people themselves are told (Art. 33 and 34).",
}
RECIPIENTS: dict[str, str] = {
    "authority": "The supervisory authority (Art. 33).",
    "subjects": "The people whose data it is (Art. 34).",
}
OUTCOMES: dict[str, str] = {
    "erased": "The records are erased, and what is left of the visit stays in quarantine.",
    "released": "The visit was that person's after all: the quarantine ends.",
}
DELAY_REASONS = ("facts-came-late", "officer-unreachable")
REASONS: dict[str, str] = {
    "matched-wrongly": "The robot took one person for another.",
    "tag-of-another": "The tag was carried by somebody else.",
    "owner-confirmed": "The person who denied the visit was there after all.",
    "nothing-released": "No picture of the visit was ever released.",
    "released-before": "Pictures had been released before the visit was denied.",
    "facts-came-late": "What had happened could not be known in time.",
    "officer-unreachable": "No officer could act in time.",
}
LOST_KEY_REASONS: dict[str, str] = {
    "key-lost": "The person's key is lost for good, and they ask for it (Art. 17(1)).",
    "owner-died": "The person died, and those who speak for them ask for it.",
    "guardian-request": "The person's guardian asks for it.",
    "authority-order": "An authority or a court ordered it (Art. 17(1)(e), Art. 58(2)(g)).",
}

_CORRECTION = "blockrobot/correction"


class Correction(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A correction with its proving salt.

    `salt`, `visit` and `record_ids` are hexadecimal; empty ids mean the whole visit.
    """

    kind: str
    text: str
    salt: str
    visit: str
    record_ids: list[str]


def commit_correction(correction: Correction) -> bytes:
    """Return the 32-byte on-chain commitment. Raises ValueError for wrong hexadecimal."""
    fields = [correction.kind.encode(), bytes.fromhex(correction.visit), correction.text.encode()]
    fields += [bytes.fromhex(record_id) for record_id in correction.record_ids]
    lengths = b"".join(len(field).to_bytes(4, "big") for field in fields)
    return tagged_hash(_CORRECTION, bytes.fromhex(correction.salt), lengths, *fields)
