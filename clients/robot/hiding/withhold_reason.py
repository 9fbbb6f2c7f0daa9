"""Why a frame, or a sample of another sensor, is withheld; and why a silhouette was taken for two people."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, doc


class MergedNumbers(Answer, frozen=True, kw_only=True):
    """Why a silhouette was taken for two people, in numbers."""

    by: Annotated[str, doc("Which rule took it for two people: `area`, `breadth`, `shape` or `before`")]
    limit: Annotated[float, doc("Above what: square metres, metres, or log-odds (`shape` and `before`)")]
    log_odds: Annotated[float, doc("Of two people")]
    area_m2: Annotated[float, doc("The silhouette's area in square metres")]
    breadth_m: Annotated[float, doc("Its breadth about half a metre below the top of the head, in metres")]
    range_m: Annotated[float, doc("How far away it was, in metres")]


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
    UNVERIFIED = "unverified"  # while driving: it is not sure enough that it is one person and nothing else
    CUT_OFF = "cut-off"  # by the picture's side
    OUT_OF_RANGE = "out-of-range"
    NO_GROUND = "no-ground"  # the floor is not where the camera's mount says, or not in the empty scene
    NOT_ALONE = "not-alone"  # for what cannot be cut down to one person
    NOT_MATCHED = "not-matched"  # the same, when nobody in the picture is known to be them
    NO_ROOM = "no-room"  # there was no memory for it until it was known whose it is
    STALE = "registry-stale"
    NO_CONSENT = "no-consent"
    OUTSIDE = "outside-consent"


class MergedBy(StrEnum):
    """The rule by which a silhouette was taken for two people."""

    AREA = "area"
    BREADTH = "breadth"
    SHAPE = "shape"
    BEFORE = "before"


MERGED_HELP = {
    MergedBy.AREA: "larger than one person is",
    MergedBy.BREADTH: "broader than one person is, at that distance",
    MergedBy.SHAPE: "the model takes the shape for two people: arms held out, a long stride, something broad",
    MergedBy.BEFORE: "one person in this frame, two in those of the last second",
}
"""What each rule means, as the end of a sentence."""


@dataclass(frozen=True, slots=True)
class MergedEvidence:
    """`limit`: square metres (`AREA`), metres (`BREADTH`), otherwise natural log-odds."""

    by: MergedBy
    limit: float
    log_odds: float
    area_m2: float
    breadth_m: float
    range_m: float

    @property
    def excess(self) -> float:
        """Excess as a share of the limit (log-odds: absolute)."""
        if self.by is MergedBy.AREA:
            return self.area_m2 / self.limit - 1
        return self.breadth_m / self.limit - 1 if self.by is MergedBy.BREADTH else self.log_odds - self.limit

    def summarise(self) -> MergedNumbers:
        return MergedNumbers(
            by=str(self.by),
            limit=round(self.limit, 2),
            log_odds=round(self.log_odds, 2),
            area_m2=round(self.area_m2, 2),
            breadth_m=round(self.breadth_m, 2),
            range_m=round(self.range_m, 2),
        )
