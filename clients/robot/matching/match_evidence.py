"""Numerical reasons why a tag stayed unbound; metres, natural log-odds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from msgspec import UNSET, UnsetType

from clients.sdk.terminal.json_answers import Answer, Count, Ms, doc

BIND_LOG_ODDS = 9.2
READINGS_MIN_COUNT = 4
# The distances by themselves must fit a person three times as well as a bearer who is not in the picture. Without that
# antennas alone would bind, and that a tag is before the robot is also true of a person just outside the picture.
DISTANCE_LOG_ODDS_MIN = 1.1
# Of distances and bearings together, for a robot that drives: wherever it stops, somebody may be beside its picture.
DRIVING_CUES_LOG_ODDS_MIN = 3.0
RIVAL_WITHIN = 5.0  # log-odds: a rival this close to the best is what stands in the way
_CONTRADICTS_BELOW = -2.3  # log-odds of the distances: an absent bearer explains them ten times as well
_SPREAD_SIGMAS = 3.0
_UNIT_MIN_DECADES = 0.8
_OFF_MIN_M = 0.3  # what the matcher takes for the reader's constant error without objection


class MatchNumbers(Answer, frozen=True, kw_only=True):
    """The matcher's numbers for a tag."""

    obstacle: Annotated[
        str,
        doc(
            "What stood in the way: `few-distances`, `behind`, `unit`, `delayed`, `off`, `vague`, `other-tag`, "
            "`rival`, `no-facing` or `undecided`"
        ),
    ]
    log_odds: Annotated[float, doc("For the person in view who fits best")]
    needed: Annotated[float, doc("The log-odds at which a tag is bound")]
    distance_log_odds: Annotated[
        float,
        doc(
            "What distances alone say for that person; 1.1 of it is needed, of a robot that drives 3 together with bearings"
        ),
    ]
    rival_log_odds: Annotated[float | UnsetType, doc("For who fits next best; absent if one person was in view")] = (
        UNSET
    )
    bearing_log_odds: Annotated[
        float | UnsetType, doc("What bearings alone say for that person; absent if the reader told none")
    ] = UNSET
    distances: Annotated[Count, doc("How many distances were compared with the camera's")]
    gap_m: Annotated[float, doc("Mean of distance minus camera range, in metres")]
    spread_m: Annotated[float, doc("Standard deviation of distance minus camera range, in metres")]
    sigma_m: Annotated[float, doc("Mean stated standard deviation, in metres")]
    front: Annotated[Count, doc("Readings by antennas that look as the camera looks")]
    back: Annotated[Count, doc("Readings by antennas that look away from it")]
    people: Annotated[Count, doc("How many people were in view")]
    delay_ms: Annotated[
        Ms | UnsetType, doc("How much later than the person the distances are; absent if no shift makes them fit")
    ] = UNSET


class Obstacle(StrEnum):
    """What prevented binding a tag to somebody in view."""

    FEW_DISTANCES = "few-distances"
    BEHIND = "behind"
    UNIT = "unit"
    DELAYED = "delayed"
    OFF = "off"
    VAGUE = "vague"
    OTHER_TAG = "other-tag"
    RIVAL = "rival"
    NO_FACING = "no-facing"
    UNDECIDED = "undecided"


HELP = {
    Obstacle.FEW_DISTANCES: "too few readings had a distance; read the tag at least every half second",
    Obstacle.BEHIND: "it was heard mostly by antennas that look away from the camera: the bearer was taken to be behind "
    "the robot. If that is wrong, exchange `front` and `back`",
    Obstacle.UNIT: "the distances are of another size than the camera's: distance_unit must be the one that the reader "
    "uses, m, cm or mm",
    Obstacle.DELAYED: "readings follow the person's distance with that delay: the reader's clock, or the stamp of its "
    "messages, is wrong",
    Obstacle.OFF: "the distances contradict the camera's: check distance_unit, from where the reader measures, and both "
    "clocks",
    Obstacle.VAGUE: "the distances say too little of who it was, for their stated error; a more exact reader helps, or one "
    "that reads more often",
    Obstacle.OTHER_TAG: "another tag fits that person about as well, and its bearer is not seen elsewhere: one of the two "
    "bearers is hidden, or beside the picture",
    Obstacle.RIVAL: "somebody else in view was about as far away. A reader that tells on which side a tag is "
    "(blockrobot robot antennas), and a smaller error of the distances, tell people apart",
    Obstacle.NO_FACING: "no reading said which way its antenna looks, so somebody out of view, as far away, could not be "
    "excluded while the person in view kept one distance. If the reader looks as the camera does, write "
    '`facing = "front"` into its [[tags]] table, in place of `front` and `back`; else have these name the antennas heard',
    Obstacle.UNDECIDED: "the evidence was not enough; more readings, or more exact ones, help",
}
"""What each obstacle means, as the end of a sentence."""


@dataclass(frozen=True, slots=True)
class MatchEvidence:
    """A tag against its best-fitting person in view.

    `distances`: number compared; `gap_m`, `spread_m`: mean and standard deviation of distance minus camera range;
    `sigma_m`: mean stated; `delay_ms`: fitting time shift; `distance_log_odds`: against absence; `front`, `back`:
    readings by antenna direction. `bearings`: number compared. `is_contested`: whether another tag may be that person's.
    """

    log_odds: float
    rival_log_odds: float | None
    distances: int
    gap_m: float
    sigma_m: float
    front: int
    back: int
    people: int
    distance_log_odds: float = 0.0
    spread_m: float = 0.0
    range_m: float = 0.0
    delay_ms: int | None = None
    bearings: int = 0
    bearing_log_odds: float = 0.0
    cues_log_odds_min: float = -math.inf  # of distances and bearings together
    is_contested: bool = False

    @property
    def is_vague(self) -> bool:
        cues = self.distance_log_odds + self.bearing_log_odds
        return self.distance_log_odds < DISTANCE_LOG_ODDS_MIN or cues < self.cues_log_odds_min

    @property
    def nearness(self) -> tuple[int, float, int]:
        """Closeness to binding; distances capped at the required number."""
        return min(self.distances, READINGS_MIN_COUNT), self.log_odds, self.distances

    @property
    def is_wrong_unit(self) -> bool:
        """Whether distances are off tenfold or more."""
        mean_m = self.gap_m + self.range_m
        return self.range_m > 0 and mean_m > 0 and abs(math.log10(mean_m / self.range_m)) > _UNIT_MIN_DECADES

    @property
    def is_off(self) -> bool:
        """Whether distances exceed their stated error."""
        return abs(self.gap_m) > max(_OFF_MIN_M, self.sigma_m) or self.spread_m > _SPREAD_SIGMAS * max(
            _OFF_MIN_M / _SPREAD_SIGMAS, self.sigma_m
        )

    @property
    def obstacle(self) -> Obstacle:
        rival = self.rival_log_odds
        found = (
            (self.distances < READINGS_MIN_COUNT, Obstacle.FEW_DISTANCES),
            (self.back > self.front, Obstacle.BEHIND),
            (self.is_wrong_unit, Obstacle.UNIT),
            (self.delay_ms is not None, Obstacle.DELAYED),
            (self.is_off or self.distance_log_odds < _CONTRADICTS_BELOW, Obstacle.OFF),
            (self.log_odds >= BIND_LOG_ODDS and self.is_vague, Obstacle.VAGUE),
            (self.log_odds >= BIND_LOG_ODDS and self.is_contested, Obstacle.OTHER_TAG),
            (rival is not None and self.log_odds - rival < RIVAL_WITHIN, Obstacle.RIVAL),
            (self.front > 0, Obstacle.UNDECIDED),
        )
        return next((obstacle for holds, obstacle in found if holds), Obstacle.NO_FACING)

    def summarise(self) -> MatchNumbers:
        return MatchNumbers(
            obstacle=str(self.obstacle),
            log_odds=round(self.log_odds, 1),
            needed=BIND_LOG_ODDS,
            distance_log_odds=round(self.distance_log_odds, 1),
            rival_log_odds=UNSET if self.rival_log_odds is None else round(self.rival_log_odds, 1),
            bearing_log_odds=round(self.bearing_log_odds, 1) if self.bearings else UNSET,
            distances=self.distances,
            gap_m=round(self.gap_m, 2),
            spread_m=round(self.spread_m, 2),
            sigma_m=round(self.sigma_m, 2),
            front=self.front,
            back=self.back,
            people=self.people,
            delay_ms=UNSET if self.delay_ms is None else self.delay_ms,
        )
