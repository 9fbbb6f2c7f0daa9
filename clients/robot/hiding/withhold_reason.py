"""Why a frame, or a sample of another sensor, is withheld: for hiding, consent and recording alike."""

from __future__ import annotations

from enum import StrEnum


class WithholdReason(StrEnum):
    """Why a covered frame has no rendition for an owner."""

    AMBIGUOUS = "ambiguous"
    CONTACT = "contact"
    MERGED = "merged"
    OCCLUDED = "occluded"
    NO_SILHOUETTE = "no-silhouette"
    NO_DISTANCE = "no-distance"
    DISORDERED = "disordered"
    MOVED = "moved"  # the robot, so that the empty scene is another one
    NOT_ALONE = "not-alone"  # for what cannot be cut down to one person
    NOT_MATCHED = "not-matched"  # the same, when nobody in the picture is known to be them
    NO_ROOM = "no-room"  # there was no memory for it until it was known whose it is
    STALE = "registry-stale"
    NO_CONSENT = "no-consent"
    OUTSIDE = "outside-consent"
