"""Plain words for the codes in the demonstration's output."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from consensus.errors import CATALOGUE

REASONS = {
    "ambiguous": "it was not sure who is to be seen",
    "contact": "people touched each other",
    "merged": "people could not be told apart, or one looked too broad",
    "occluded": "somebody or something stood before them",
    "no-silhouette": "they were near, but not in the picture",
    "no-distance": "the reader gave no distance",
    "disordered": "the frame came out of order",
    "moved": "the robot had moved",
    "unverified": "it was not sure that they were alone in the picture",
    "cut-off": "they reached beyond the picture's side",
    "out-of-range": "they were too near or too far",
    "no-ground": "the floor was not where it should be",
    "not-alone": "they were not alone",
    "not-matched": "nobody in the picture was known to be them",
    "no-room": "there was no memory for it until it was known whose it was",
    "registry-stale": "the list of consents was too old",
    "no-consent": "they had not consented",
    "outside-consent": "it was outside the time that they consented to",
}
EVENTS = {
    "visit_opened": "the robot met them",
    "recorded": "recorded",
    "visit_closed": "the visit ended",
    "access_requested": "they asked to look",
    "access_released": "a custodian handed it out",
    "access_refused": "a custodian refused",
    "verdict": "they checked it",
    "erasure_requested": "they asked to erase",
    "erasure_receipted": "a custodian confirmed the erasure",
    "erasure_complete": "erased everywhere",
    "expired": "erased by expiry",
}
FRAMES = {
    "published": "frames of the camera",
    "covered": "frames near a patient's tag",
    "kept": "kept",
    "withheld": "withheld",
    "withheld_reasons": "withheld because",
    "lost": "lost",
}
LATENCIES = {
    "frame_to_final": "from the end of pairing to the final record",
    "decided_to_final": "from the decision to keep it to the final record",
    "arrival_to_final": "from a frame's arrival to its final record",
    "submit_to_final": "from handing a transaction in to its being final",
}
_QUANTILES = {"p50": "half within", "p95": "95 of 100 within", "max": "all within"}


def name_person(alias: str) -> str:
    kind, _, letter = alias.partition("-")
    return f"{kind} {letter.upper()}" if kind == "patient" and len(letter) == 1 else alias


def refusal_text(code: str | None) -> str:
    if code is None:
        return "with the record"
    meaning = CATALOGUE[code].meaning.rstrip(".") if code in CATALOGUE else "refused"
    return f"“{meaning}” ({code})"


def reasons_text(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count}: {REASONS.get(reason, reason)}" for reason, count in counts.items()) or "none"


def events_text(kinds: Iterable[str]) -> str:
    return ", ".join(EVENTS.get(kind, kind) for kind in dict.fromkeys(kinds))


def quantiles_text(values: Mapping[str, float]) -> str:
    return ", ".join(f"{_QUANTILES.get(name, name)} {value:,}" for name, value in values.items())
