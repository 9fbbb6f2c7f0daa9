"""Every verdict of the redactor and why: people are placed by hand instead of being found in pictures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest

from clients.robot.hiding import standing_hider as hider_module
from clients.robot.hiding.background import learn_background
from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.frame_redactor import BUFFER_DEFAULT_MS, FrameRedactor, KeptFrame, Output, WithheldFrame
from clients.robot.hiding.segmentation import EMPTY_MAX_PX, Labels, Segmented, Silhouette
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.matching.match_evidence import BIND_LOG_ODDS, HELP, MatchEvidence, Obstacle
from clients.robot.sensing.sensor_events import Facing, Frame, Sighting

SHAPE = (40, 60)
EVERY_MS = 100
SIGMA_M = 0.2


@dataclass(frozen=True)
class Place:
    """Where a person is seen in one frame."""

    x_m: float
    z_m: float
    withhold_reason: str = ""

    @property
    def range_m(self) -> float:
        return math.hypot(self.x_m, self.z_m)


Scene = dict[int, list[Place]]  # by frame time


class Stage:
    """Plays scenes and readings to a redactor whose segmentation says what the scene says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **options: int) -> None:
        monkeypatch.setattr(hider_module, "segment", lambda *_: self._segmented)
        monkeypatch.setattr(
            hider_module,
            "extract_encoded_cutout",
            lambda _d, _b, _s, silhouette: EncodedCutout(silhouette.label, 0, 1, 1, b""),
        )
        self.depth = np.full(SHAPE, 3_000, np.uint16)
        self.redactor = FrameRedactor(learn_background([self.depth] * 5), **options)
        self.outputs: list[Output] = []
        self.sequence = 0
        self.labels: Labels | None = None

    def frame(self, at_ms: int, places: list[Place]) -> None:
        silhouettes = tuple(
            Silhouette(
                i + 1,
                (0, 0, 1, 1),
                p.x_m,
                p.z_m,
                p.range_m,
                round(p.z_m * 1000),
                p.withhold_reason,
                companion_odds=20.0 if p.withhold_reason == "merged" else -20.0,
                ahead_m=p.z_m,
                right_m=p.x_m,
            )
            for i, p in enumerate(places)
        )
        self._segmented = Segmented(silhouettes, self.labels)
        self.sequence += 1
        self.outputs += self.redactor.push_frame(Frame(at_ms, self.sequence, self.depth))

    def play(self, scene: Scene, readings: list[tuple[str, Sighting]], *, unknown: tuple[str, ...] = ()) -> None:
        waiting = sorted(readings, key=lambda item: item[1].middle_ms)
        for at_ms, places in scene.items():
            while waiting and waiting[0][1].middle_ms <= at_ms:
                alias, sighting = waiting.pop(0)
                self.outputs += self.redactor.push_sighting(alias, sighting, known=alias not in unknown)
            self.frame(at_ms, places)
        self.outputs += self.redactor.flush()

    def kept(self, alias: str) -> list[KeptFrame]:
        return [o for o in self.outputs if isinstance(o, KeptFrame) and o.alias == alias]

    def reasons(self, alias: str, first_ms: int = 0, last_ms: int = 10**9) -> Counter[WithholdReason]:
        return Counter(
            o.reason
            for o in self.outputs
            if isinstance(o, WithheldFrame) and o.alias == alias and first_ms <= o.captured_at_ms <= last_ms
        )


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Stage:
    return Stage(monkeypatch)


def stroll(at_ms: int, *, x_m: float = 0.0, middle_m: float = 2.5, swing_m: float = 0.6) -> Place:
    return Place(x_m, middle_m + swing_m * math.sin(at_ms / 900))


def times(first_s: float, last_s: float) -> range:
    return range(round(first_s * 1000), round(last_s * 1000), EVERY_MS)


def read(
    alias: str, at_ms: int, distance_m: float | None, rng: np.random.Generator, facing: Facing = Facing.FRONT
) -> tuple[str, Sighting]:
    measured = (None, None) if distance_m is None else (distance_m + float(rng.normal(0, SIGMA_M)), SIGMA_M)
    return alias, Sighting(at_ms, at_ms, "", 1 if facing is Facing.FRONT else 2, facing, -50.0, *measured)


def worn(
    alias: str, first_s: float, last_s: float, *, seed: int = 1, every_ms: int = 400
) -> list[tuple[str, Sighting]]:
    """Readings of a tag that the stroller wears."""
    rng = np.random.default_rng(seed)
    return [
        read(alias, at, stroll(at).range_m, rng) for at in range(round(first_s * 1000), round(last_s * 1000), every_ms)
    ]


def test_frames_from_before_the_binding_are_released_once_it_stands(stage: Stage) -> None:
    stage.play({at: [stroll(at)] for at in times(0, 14)}, worn("ann", 0, 14))
    assert [kept.captured_at_ms for kept in stage.kept("ann")] == list(times(0, 14))
    assert stage.reasons("ann") == Counter()


def test_nothing_is_released_before_it_is_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage(monkeypatch)
    readings = worn("ann", 0, 14)
    first_kept_at_ms = None
    for at in times(0, 14):
        for alias, sighting in readings:
            if at - EVERY_MS < sighting.middle_ms <= at:
                stage.redactor.push_sighting(alias, sighting)
        stage.frame(at, [stroll(at)])
        if stage.kept("ann"):
            first_kept_at_ms = at
            break
        assert max(stage.redactor.matcher.log_odds("ann").values(), default=0.0) < 9.2 or at < 6_100
    assert first_kept_at_ms is not None
    assert first_kept_at_ms > 6_000  # not before its owners are certain


def test_what_is_older_than_the_buffer_when_the_tag_is_bound_stays_withheld(stage: Stage) -> None:
    """For twelve seconds the tag is read without distance, then with: two seconds are lost, ten are released."""
    rng = np.random.default_rng(2)
    blind = [read("ann", at, None, rng) for at in range(0, 12_000, 400)]
    stage.play({at: [stroll(at)] for at in times(0, 24)}, blind + worn("ann", 12, 24))
    first_kept_ms = stage.kept("ann")[0].captured_at_ms
    assert 2_000 < first_kept_ms < 9_000
    assert set(stage.reasons("ann", 0, 1_900)) == {WithholdReason.NO_DISTANCE}
    assert set(stage.reasons("ann")) <= {WithholdReason.NO_DISTANCE, WithholdReason.AMBIGUOUS}
    assert [kept.captured_at_ms for kept in stage.kept("ann")] == list(range(first_kept_ms, 24_000, EVERY_MS))


def test_a_longer_buffer_releases_what_a_shorter_one_withholds(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    readings = [read("ann", at, None, rng) for at in range(0, 12_000, 400)] + worn("ann", 12, 24)
    counts = []
    for buffer_ms in (BUFFER_DEFAULT_MS, 20_000):
        stage = Stage(monkeypatch, buffer_ms=buffer_ms)
        stage.play({at: [stroll(at)] for at in times(0, 24)}, readings)
        counts.append(len(stage.kept("ann")))
    assert counts[0] < counts[1] == 240


def test_two_whom_the_readings_cannot_tell_apart_are_ambiguous(stage: Stage) -> None:
    stage.play({at: [stroll(at, x_m=-0.8), stroll(at, x_m=0.8)] for at in times(0, 14)}, worn("ann", 0, 14))
    assert not stage.kept("ann")
    assert set(stage.reasons("ann")) == {WithholdReason.AMBIGUOUS}


def test_a_bearer_behind_the_robot_is_ambiguous_while_somebody_else_is_in_view(stage: Stage) -> None:
    rng = np.random.default_rng(3)
    behind = [read("ann", at, 2.5, rng, Facing.BACK) for at in range(0, 14_000, 400)]
    stage.play({at: [Place(0.0, 2.5)] for at in times(0, 14)}, behind)
    assert not stage.kept("ann")
    assert set(stage.reasons("ann")) == {WithholdReason.AMBIGUOUS}


def nearest(stage: Stage, alias: str) -> MatchEvidence:
    """Return the numbers of the last frame that was ambiguous."""
    found = [o.evidence for o in stage.outputs if isinstance(o, WithheldFrame) and o.alias == alias and o.evidence]
    return found[-1]


def standing(
    facing: Facing, *, distance_m: float = 2.5, every_ms: int = 400, until_ms: int = 14_000
) -> list[tuple[str, Sighting]]:
    rng = np.random.default_rng(4)
    return [read("ann", at, distance_m, rng, facing) for at in range(0, until_ms, every_ms)]


@pytest.mark.parametrize(
    ("readings", "places", "obstacle"),
    [
        (standing(Facing.UNKNOWN), [Place(0.0, 2.5)], Obstacle.NO_FACING),
        (standing(Facing.BACK), [Place(0.0, 2.5)], Obstacle.BEHIND),
        (standing(Facing.FRONT, distance_m=5.5), [Place(0.0, 2.5)], Obstacle.OFF),
        (standing(Facing.FRONT, until_ms=1_000), [Place(0.0, 2.5)], Obstacle.FEW_DISTANCES),
        (standing(Facing.FRONT), [Place(-0.8, 2.4), Place(0.8, 2.4)], Obstacle.RIVAL),
    ],
)
def test_an_ambiguous_frame_says_in_numbers_what_stood_in_the_way(
    stage: Stage, readings: list[tuple[str, Sighting]], places: list[Place], obstacle: Obstacle
) -> None:
    stage.play(dict.fromkeys(times(0, 14), places), readings)
    assert set(stage.reasons("ann")) == {WithholdReason.AMBIGUOUS}
    evidence = nearest(stage, "ann")
    assert evidence.obstacle is obstacle
    assert evidence.log_odds < BIND_LOG_ODDS or obstacle is Obstacle.FEW_DISTANCES
    assert (evidence.distances, evidence.people) == (len(readings), len(places))
    assert evidence.sigma_m == pytest.approx(SIGMA_M)
    assert set(msgspec.to_builtins(evidence.summarise())) - {"rival_log_odds"} == {
        "obstacle", "log_odds", "needed", "distance_log_odds", "distances", "gap_m", "spread_m",
        "sigma_m", "front", "back", "people",
    }  # fmt: skip


@pytest.mark.parametrize(("off_m", "is_told"), [(0.0, False), (0.45, True)])
def test_a_kept_frame_says_so_where_the_distances_disagree_with_the_camera(
    stage: Stage, off_m: float, is_told: bool
) -> None:
    readings = [replace(s, distance_m=(s.distance_m or 0) + off_m) for _, s in worn("ann", 0, 14)]
    stage.play({at: [stroll(at)] for at in times(0, 14)}, [("ann", reading) for reading in readings])
    kept = stage.kept("ann")
    assert kept
    assert any(one.evidence is not None for one in kept) is is_told


def test_every_obstacle_is_explained() -> None:
    assert set(HELP) == set(Obstacle)


def test_a_tag_in_an_empty_corridor_has_no_silhouette(stage: Stage) -> None:
    stage.play({at: [] for at in times(0, 9)}, worn("ann", 0, 9))
    assert set(stage.reasons("ann")) == {WithholdReason.NO_SILHOUETTE}


def test_when_the_bearer_has_left_nobody_else_is_taken_for_them(stage: Stage) -> None:
    stranger = Place(1.0, 4.5)
    scene = {at: [stroll(at), stranger] for at in times(0, 12)} | {at: [stranger] for at in times(12, 16)}
    stage.play(scene, worn("ann", 0, 12))
    late = [kept for kept in stage.kept("ann") if kept.captured_at_ms >= 12_000]
    assert not late
    assert set(stage.reasons("ann", 12_000)) == {WithholdReason.NO_SILHOUETTE}


@pytest.mark.parametrize("withhold_reason", ["contact", "occluded"])
def test_a_bound_bearer_in_trouble_is_withheld_for_that_frame_only(stage: Stage, withhold_reason: str) -> None:
    def place(at: int) -> Place:
        whole = stroll(at)
        return Place(whole.x_m, whole.z_m, withhold_reason if 6_000 <= at < 7_000 else "")

    stage.play({at: [place(at)] for at in times(0, 14)}, worn("ann", 0, 14))
    assert stage.reasons("ann") == Counter({WithholdReason(withhold_reason): 10})
    assert len(stage.kept("ann")) == 130


def test_a_frame_in_which_somebody_vanished_beside_the_bearer_is_withheld(stage: Stage) -> None:
    """They may stand half behind, and show in the bearer's silhouette."""
    gone = times(9.0, 9.2)
    scene = {at: [stroll(at), *([] if at in gone else [Place(0.75, stroll(at).z_m + 0.6)])] for at in times(0, 14)}
    stage.play(scene, worn("ann", 0, 14))
    assert stage.reasons("ann", gone[0], gone[-1]) == {WithholdReason.OCCLUDED: len(gone)}
    assert stage.kept("ann")


def test_a_merged_blob_is_nobodys_and_the_bearer_is_known_again_after_it(stage: Stage) -> None:
    def places(at: int) -> list[Place]:
        blob = 12_000 <= at < 13_000
        return [Place(0.0, stroll(at).z_m, "merged")] if blob else [stroll(at), Place(0.9, 3.6)]

    stage.play({at: places(at) for at in times(0, 26)}, worn("ann", 0, 26))
    assert stage.reasons("ann", 12_000, 12_999) == Counter({WithholdReason.MERGED: 10})
    assert stage.reasons("ann", 0, 11_999) == Counter()
    assert [k.cutout.x for k in stage.kept("ann") if k.captured_at_ms >= 13_000].count(2) == 0
    assert len([k for k in stage.kept("ann") if k.captured_at_ms >= 13_000]) > 100


def test_who_was_just_parted_from_the_bearer_is_not_shown_while_the_bearer_still_counts_as_merged(stage: Stage) -> None:
    """Only the other has a track then, at nearly the bearer's own range."""

    def places(at: int) -> list[Place]:
        if at < 2_000:
            return [Place(0.0, stroll(at).z_m, "merged")]
        return [Place(0.0, stroll(at).z_m, "merged" if at < 9_000 else ""), stroll(at + 150, x_m=1.2)]

    stage.play({at: places(at) for at in times(0, 14)}, worn("ann", 0, 14))
    assert {kept.cutout.x for kept in stage.kept("ann")} <= {1}


def hiding_ann(at: int) -> list[Place]:
    """They went together for three seconds; then one alone is seen, and ann is right behind."""
    return [Place(0.0, stroll(at).z_m - 0.15, "merged" if at < 3_000 else "")]


def hiding_ann_and_unseen_for_a_while(at: int) -> list[Place]:
    return [] if 6_000 <= at < 7_300 else hiding_ann(at)


def hiding_ann_while_a_stranger_comes_in(at: int) -> list[Place]:
    return [*hiding_ann(at), *([Place(2.9, 6.5)] if at >= 8_000 else [])]


def three_of_whom_two_are_seen(at: int) -> list[Place]:
    near = stroll(at).z_m - 0.15
    if at < 1_000:
        return [Place(-0.3, near), Place(0.3, near), Place(0.0, near + 0.4)]
    return [Place(0.0, near, "merged")] if at < 3_000 else [Place(-0.3, near), Place(0.5, near + 1.5)]


@pytest.mark.parametrize(
    "places",
    [hiding_ann, hiding_ann_and_unseen_for_a_while, hiding_ann_while_a_stranger_comes_in, three_of_whom_two_are_seen],
)
def test_who_hides_the_bearer_is_not_taken_for_the_bearer(stage: Stage, places: Callable[[int], list[Place]]) -> None:
    stage.play({at: places(at) for at in times(0, 20)}, worn("ann", 0, 20))
    assert stage.kept("ann") == []


def test_a_couple_far_away_that_parts_and_meets_stands_in_nobodys_way(stage: Stage) -> None:
    def places(at: int) -> list[Place]:
        return [stroll(at), Place(1.0, 5.6, "merged" if at % 10_000 < 1_000 else "")]

    stage.play({at: places(at) for at in times(0, 30)}, worn("ann", 0, 30))
    assert len(stage.kept("ann")) > 250


def test_readings_without_distance_never_suffice_though_only_one_is_in_view(stage: Stage) -> None:
    rng = np.random.default_rng(4)
    stage.play({at: [stroll(at)] for at in times(0, 9)}, [read("ann", at, None, rng) for at in range(0, 9_000, 300)])
    assert set(stage.reasons("ann")) == {WithholdReason.NO_DISTANCE}


def test_the_bearer_is_not_alone_while_others_in_the_picture_merge(stage: Stage) -> None:
    stage.play({at: [stroll(at), Place(3.0, 6.5, "merged")] for at in times(0, 20)}, worn("ann", 0, 20))
    assert stage.kept("ann")
    assert not any(kept.alone for kept in stage.kept("ann"))


def test_who_stands_there_after_the_clock_was_set_back_is_somebody_else(stage: Stage) -> None:
    """How long nobody was looked at in between, no stamp says."""
    first, again = times(200, 220), times(100, 110)
    stage.play({at: [stroll(at)] for at in first}, worn("ann", 200, 220))
    assert stage.kept("ann")
    stage.outputs.clear()
    rng = np.random.default_rng(4)
    for at in again:
        stage.outputs += stage.redactor.push_sighting("ann", read("ann", at, None, rng)[1])
        stage.sequence += 1
        stage.outputs += stage.redactor.push_frame(Frame(at, stage.sequence, stage.depth, received_at_ms=at))
    stage.outputs += stage.redactor.flush()
    assert stage.kept("ann") == []
    assert set(stage.reasons("ann")) == {WithholdReason.NO_DISTANCE}


def test_a_frame_that_goes_back_in_time_is_disordered(stage: Stage) -> None:
    scene = {at: [stroll(at)] for at in times(0, 13)}
    scene[12_850] = [stroll(12_850)]
    stage.play(scene, worn("ann", 0, 13))
    assert stage.reasons("ann") == Counter({WithholdReason.DISORDERED: 1})


def test_two_tags_on_one_silhouette_show_neither_bearer_even_if_one_is_unknown(stage: Stage) -> None:
    """One silhouette cannot be two people: either it hides two, or a tag is where it should not be."""
    readings = worn("ann", 0, 14) + worn("somebody", 0, 14, seed=5)
    stage.play({at: [stroll(at)] for at in times(0, 14)}, readings, unknown=("somebody",))
    late = [kept for kept in stage.kept("ann") if kept.captured_at_ms > 6_000]
    assert not late
    assert set(stage.reasons("ann")) <= {WithholdReason.AMBIGUOUS}


def test_a_second_tag_that_is_read_without_distance_does_not_hide_its_bearer(stage: Stage) -> None:
    rng = np.random.default_rng(6)
    blind = [read("badge", at, None, rng) for at in range(0, 14_000, 400)]
    stage.play({at: [stroll(at)] for at in times(0, 14)}, worn("ann", 0, 14) + blind, unknown=("badge",))
    assert len(stage.kept("ann")) == 140


def test_a_tag_read_while_two_people_cross_shows_its_bearer_only(stage: Stage) -> None:
    """They pass each other at seven seconds: at the same range for a moment, a metre and a half apart across."""

    def towards(at: int) -> Place:
        return Place(-0.75, 4.5 - 0.22 * at / 1000)

    def away(at: int) -> Place:
        return Place(0.75, 1.4 + 0.22 * at / 1000)

    rng = np.random.default_rng(7)
    readings = [read("ann", at, towards(at).range_m, rng) for at in range(0, 14_000, 400)]
    stage.play({at: [away(at), towards(at)] for at in times(0, 14)}, readings)
    assert len(stage.kept("ann")) == 140
    assert {kept.cutout.x for kept in stage.kept("ann")} == {2}


def test_a_storm_of_readings_between_two_frames_settles_nothing_and_costs_no_memory(stage: Stage) -> None:
    stage.frame(0, [stroll(0)])
    rng = np.random.default_rng(8)
    for i in range(10_000):
        alias, sighting = read(f"tag-{i % 20}", i // 10, 2.5, rng)
        assert stage.redactor.push_sighting(alias, sighting) == []
    assert stage.redactor.matcher.held_count <= 20 * 10


@pytest.mark.parametrize(("stray_px", "alone"), [(0, True), (EMPTY_MAX_PX - 1, True), (EMPTY_MAX_PX, False)])
def test_who_is_cut_off_by_the_pictures_edge_is_in_the_picture_too(stage: Stage, stray_px: int, alone: bool) -> None:
    stage.labels = np.zeros((20, 30), dtype=np.int32)
    stage.labels.flat[:stray_px] = -1
    stage.labels[-2:] = 1
    stage.play({at: [stroll(at)] for at in times(0, 14)}, worn("ann", 0, 14))
    assert {kept.alone for kept in stage.kept("ann")} == {alone}
