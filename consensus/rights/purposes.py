"""The published list of purpose codes; genesis names those used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from consensus.errors import BlockRobotError

PURPOSE_MAX_CHARS = 32

PURPOSES: dict[str, str] = {
    "care": "Care and treatment of the person.",
    "companionship": "Company, guidance and entertainment by the robot.",
    "safety": "Finding falls and other accidents.",
    "research": "Research that an ethics board has approved.",
    "teaching": "Teaching and training of staff.",
    "service": "Repair and improvement of the robot.",
    "demo": "A demonstration with people who know that it is one.",
    "own-access": "A person looks at what was recorded of them.",
    "complaint": "A complaint or a question of law.",
    "audit": "A check by data protection.",
}


def require_purpose(code: str) -> str:
    """Return a purpose's sentence. Raises PURPOSE_UNKNOWN."""
    sentence = PURPOSES.get(code)
    if sentence is None:
        raise BlockRobotError("PURPOSE_UNKNOWN", f"{code[:PURPOSE_MAX_CHARS]!r} is no purpose: {', '.join(PURPOSES)}.")
    return sentence


def require_published(codes: Iterable[str], published: Sequence[str]) -> None:
    """Require published purposes. Raises PURPOSE_UNKNOWN, naming the published ones."""
    for code in codes:
        if code not in published:
            text = f"{code[:PURPOSE_MAX_CHARS]!r} is no purpose of this network. It publishes: {', '.join(published)}."
            raise BlockRobotError("PURPOSE_UNKNOWN", text)
