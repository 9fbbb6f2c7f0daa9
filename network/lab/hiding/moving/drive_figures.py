"""Figures over many drives, with bounds by scene: frames of one scene are not independent."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Sequence

from msgspec import UNSET, Struct, UnsetType
from msgspec.structs import asdict

from network.bench.conditions import percentile
from network.lab.hiding.figures import GOAL_DIFFERENCE, GOAL_REID
from network.lab.hiding.moving.blank_attacks import BlankFigures
from network.lab.hiding.moving.neighbours import NeighbourFigures
from network.lab.hiding.moving.run_drive import DrivePlayed, PersonFrame, Shown
from network.lab.hiding.scoring import mean_of, share_of, upper_bound

GOAL_FOREIGN_SHARE = 0.001
GOAL_KEPT, GOAL_KEPT_END_TO_END = 0.55, 0.35
GOAL_FRAME_MS, GOAL_FRAME_P95_MS = 10.0, 15.0
SCENES_MIN_COUNT = 20  # with something to attack: a bound by resampling says nothing of fewer
AID_MIN_SHARE = 0.8
AIDS_HELD = ("stick", "wheelchair", "child", "iv-pole", "rollator")


class ShownFigures(Struct, kw_only=True):
    """What the pictures of some drives showed. `*_upper95`: of the share of scenes that do so."""

    pictures: int
    leaking_scenes: int
    leaking_scenes_upper95: float
    foreign_share_max: float
    foreign_px_max: int
    pictures_of_things: int
    pictures_of_others: int
    wrong_scenes_upper95: float
    owner_pixels_kept: float | None


class DriveFigures(Struct, kw_only=True):
    """`everybody`: each person in turn as the owner, by the moving hider; `end_to_end`: owners, with tags and matcher.

    `kept`: of frames in range, apart and wholly in the picture while the robot drives. `kept_end_to_end`: of owners' frames
    in range and apart while it drives, `kept_standing` while it stands before. `withheld`: of `kept_end_to_end`, by reason;
    `withheld_by_reason`: shares of `kept`'s frames, by what people have with them and reason.
    """

    scenes: int
    everybody: ShownFigures
    end_to_end: ShownFigures
    kept: float | None
    kept_end_to_end: float | None
    kept_standing: float | None
    kept_by_aid: dict[str, float | None]
    frames_by_aid: dict[str, int]
    withheld: dict[str, int]
    withheld_by_reason: dict[str, dict[str, float]]


class MovingFigures(DriveFigures, kw_only=True):
    """All drives, each stratum by itself, and the moving hider's time for a frame in one thread.

    `attacks`, `neighbours`: what attackers find who learned from other drives; unset, and without a goal, if nobody asked.
    """

    frame_ms: float | None
    frame_p95_ms: float | None
    companion_scenes: int
    strata: dict[str, DriveFigures]
    attacks: BlankFigures | UnsetType = UNSET
    neighbours: NeighbourFigures | UnsetType = UNSET
    goals: dict[str, bool] = {}


def summarise_drives(
    played: Sequence[DrivePlayed],
    attacks: BlankFigures | UnsetType = UNSET,
    neighbours: NeighbourFigures | UnsetType = UNSET,
) -> MovingFigures:
    times = [value for one in played for value in one.frame_ms]
    strata = sorted({one.stratum for one in played})
    figures = MovingFigures(
        **asdict(_figures_of(played)),
        frame_ms=round(statistics.median(times), 2) if times else None,
        frame_p95_ms=round(percentile(times, 0.95), 2) if times else None,
        companion_scenes=sum(one.stratum == "companions" for one in played),
        strata={name: _figures_of([one for one in played if one.stratum == name]) for name in strata},
        attacks=attacks,
        neighbours=neighbours,
    )
    figures.goals = _goals(figures)
    return figures


def _figures_of(played: Sequence[DrivePlayed]) -> DriveFigures:
    def kept(where: Callable[[DrivePlayed], Shown], which: Callable[[PersonFrame], bool]) -> float | None:
        frames = [(where(one).kept, frame) for one in played for frame in one.people if frame.counts and which(frame)]
        return share_of(sum((frame.number, frame.sequence) in found for found, frame in frames), len(frames))

    def kept_with(aid: str) -> float | None:
        return kept(lambda one: one.everybody, lambda frame: frame.whole and frame.driving and frame.aid == aid)

    aids = sorted({frame.aid for one in played for frame in one.people if frame.aid})
    whole = [frame for one in played for frame in one.people if frame.counts and frame.whole and frame.driving]
    return DriveFigures(
        scenes=len(played),
        everybody=_shown([one.everybody for one in played]),
        end_to_end=_shown([one.end_to_end for one in played]),
        kept=kept(lambda one: one.everybody, lambda frame: frame.whole and frame.driving),
        kept_end_to_end=kept(lambda one: one.end_to_end, lambda frame: frame.tagged and frame.driving),
        kept_standing=kept(lambda one: one.end_to_end, lambda frame: frame.tagged and not frame.driving),
        kept_by_aid={aid or "none": kept_with(aid) for aid in ("", *aids)},
        frames_by_aid=dict(sorted(Counter(frame.aid or "none" for frame in whole).items())),
        withheld=_reasons(played),
        withheld_by_reason=_reasons_by_aid(played),
    )


def _reasons(played: Sequence[DrivePlayed]) -> dict[str, int]:
    counted = Counter(
        one.withheld.get((frame.number, frame.sequence), "not-covered")
        for one in played
        for frame in one.people
        if frame.counts and frame.tagged and frame.driving
        if (frame.number, frame.sequence) not in one.end_to_end.kept
    )
    return dict(sorted(counted.items()))


def _reasons_by_aid(played: Sequence[DrivePlayed]) -> dict[str, dict[str, float]]:
    counted: dict[str, Counter[str]] = {}
    for one in played:
        for frame in one.people:
            if frame.counts and frame.whole and frame.driving:
                reason = one.withheld_everybody.get((frame.number, frame.sequence), "")
                for group in ("all", frame.aid or "none"):
                    counted.setdefault(group, Counter())[reason] += 1
    return {
        group: {reason: round(n / counts.total(), 4) for reason, n in counts.most_common() if reason}
        for group, counts in sorted(counted.items())
    }


def _shown(found: Sequence[Shown]) -> ShownFigures:
    leaking = sum(one.foreign_share > GOAL_FOREIGN_SHARE for one in found)
    wrong = sum(one.wrong > 0 for one in found)
    return ShownFigures(
        pictures=sum(len(one.kept) + one.things + one.wrong for one in found),
        leaking_scenes=leaking,
        leaking_scenes_upper95=round(upper_bound(leaking, len(found)), 4),
        foreign_share_max=round(max((one.foreign_share for one in found), default=0.0), 5),
        foreign_px_max=max((one.foreign_px for one in found), default=0),
        pictures_of_things=sum(one.things for one in found),
        pictures_of_others=sum(one.wrong for one in found),
        wrong_scenes_upper95=round(upper_bound(wrong, len(found)), 4),
        owner_pixels_kept=mean_of([share for one in found for share in one.owner_shares]),
    )


def _goals(figures: MovingFigures) -> dict[str, bool]:
    def at_least(value: float | None, limit: float) -> bool:
        return value is not None and value >= limit

    def at_most(value: float | None, limit: float) -> bool:
        return value is not None and value <= limit

    asked: dict[str, bool] = {}
    if figures.attacks is not UNSET:
        upper, enough = figures.attacks.difference_upper95, figures.attacks.attacked_scenes >= SCENES_MIN_COUNT
        asked[f"attacker_difference_upper95 <= {GOAL_DIFFERENCE}"] = enough and at_most(upper, GOAL_DIFFERENCE)
    if figures.neighbours is not UNSET:
        upper, enough = figures.neighbours.rate_upper95, figures.neighbours.drives >= SCENES_MIN_COUNT
        limit = figures.neighbours.chance + GOAL_REID
        asked[f"neighbour_rate_upper95 <= chance + {GOAL_REID}"] = enough and at_most(upper, limit)
    none, held = figures.kept_by_aid.get("none"), {aid: figures.kept_by_aid.get(aid) for aid in AIDS_HELD}
    return {
        "no scene shows anybody else": figures.everybody.leaking_scenes + figures.end_to_end.leaking_scenes == 0,
        "no picture of a thing": figures.everybody.pictures_of_things + figures.end_to_end.pictures_of_things == 0,
        "no picture of another": figures.end_to_end.pictures_of_others == 0,
        f"kept >= {GOAL_KEPT}": at_least(figures.kept, GOAL_KEPT),
        f"kept_end_to_end >= {GOAL_KEPT_END_TO_END}": at_least(figures.kept_end_to_end, GOAL_KEPT_END_TO_END),
        **{
            f"{aid} >= {AID_MIN_SHARE} of none": none is not None and at_least(share, AID_MIN_SHARE * none)
            for aid, share in held.items()
        },
        f"frame_ms <= {GOAL_FRAME_MS:g}": at_most(figures.frame_ms, GOAL_FRAME_MS),
        f"frame_p95_ms <= {GOAL_FRAME_P95_MS:g}": at_most(figures.frame_p95_ms, GOAL_FRAME_P95_MS),
        **asked,
    }
