"""The published list of purposes for which people are recorded and records are looked at. Must never hold free text.

A purpose stands on the chain for ever, so it is a code from this list; what is said beyond it is sealed. A network's
genesis file names the codes that it uses.
"""

from __future__ import annotations

from consensus.errors import BlockRobotError

PURPOSE_MAX_CHARS = 32

PURPOSES: dict[str, str] = {
    "care": "Care and treatment of the person herself.",
    "companionship": "Company, guidance and entertainment by the robot.",
    "safety": "Finding falls and other accidents.",
    "research": "Research that an ethics board has approved.",
    "teaching": "Teaching and training of staff.",
    "service": "Repair and improvement of the robot.",
    "demo": "A demonstration with people who know that it is one.",
    "own-access": "A person looks at what was recorded of herself.",
    "complaint": "A complaint or a question of law.",
    "audit": "A check by data protection.",
}


def require_purpose(code: str) -> str:
    """Return the plain sentence of a purpose. Raises VALUE_INVALID for a code that is not on the list."""
    sentence = PURPOSES.get(code)
    if sentence is None:
        raise BlockRobotError("VALUE_INVALID", f"{code[:PURPOSE_MAX_CHARS]!r} is no purpose: {', '.join(PURPOSES)}.")
    return sentence
