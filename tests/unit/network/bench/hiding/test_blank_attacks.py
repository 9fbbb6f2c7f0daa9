"""Attackers on blank pictures of drives: what they find beyond the control; what nobody asked for has no goal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from msgspec import UNSET

from clients.robot.hiding.cutouts import Cutout, encode_cutout
from clients.robot.sensing.sensor_events import Mask
from clients.robot.synthetic.driving.draws import draw_drive
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer
from consensus.errors import BlockRobotError
from network.lab.hiding.attacks import CONTROL, CONTROL_NOT_CUT, ON_OURS, OURS
from network.lab.hiding.learned import Example, LearnedAttacker, train
from network.lab.hiding.moving import evaluate_drives, neighbours
from network.lab.hiding.moving.blank_attacks import BlankReport, BlankScore, attack_drive, blank_view, summarise_attacks
from network.lab.hiding.moving.drive_figures import summarise_drives
from network.lab.hiding.moving.evaluate_drives import Judged, Watched
from network.lab.hiding.moving.neighbours import (
    FRAMES_COUNT,
    KNOWING,
    PATTERN,
    PICTURES,
    TAKES_COUNT,
    Clue,
    summarise_neighbours,
    watch_neighbours,
)
from network.lab.hiding.moving.run_drive import DrivePlayed, Rendition, others_of, show_everybody
from network.lab.hiding.run_scene import spread_cutout

DIFFERENCE_GOAL, NEIGHBOUR_GOAL = "attacker_difference_upper95 <= 0.02", "neighbour_rate_upper95 <= chance + 0.05"


class NobodyFound(LearnedAttacker):
    def recover(self, view: object, *, every: int = 1) -> Mask:
        return np.zeros((240, 320), dtype=bool)


NOBODY_FOUND = NobodyFound(None, 0.5)


def rendition(drive: Drive, one: Rendition, shown: Mask) -> Rendition:
    depth = DriveRenderer(drive).truth(one.sequence).depth
    return replace(one, cutout=encode_cutout(Cutout(0, 0, np.where(shown, depth, np.uint16(0)))))


@pytest.fixture(scope="module")
def drive() -> Drive:
    return draw_drive(5_100_000, "straight", judging=False)


@pytest.fixture(scope="module")
def near(drive: Drive) -> Rendition:
    """A released picture with somebody else in view."""
    return next(one for one in show_everybody(drive) if one.released and np.isfinite(one.gap_px))


def test_a_released_picture_is_as_if_nobody_else_were_there(drive: Drive, near: Rendition) -> None:
    report = attack_drive(drive, [near], NOBODY_FOUND)
    (score,) = report.frames
    assert score.outline_iou > 0.98
    assert score.foreign_px == 0
    assert abs(score.ious[OURS, "bite"] - score.ious[CONTROL, "bite"]) < 0.005


def test_who_is_in_the_picture_or_bites_into_it_is_found_beyond_the_control(drive: Drive, near: Rendition) -> None:
    truth = DriveRenderer(drive).truth(near.sequence)
    others, own = others_of(truth, near.number), truth.labels == near.number
    (leak,) = attack_drive(drive, [rendition(drive, near, own | others)], NOBODY_FOUND).frames
    assert leak.ious[OURS, "outline"] - leak.ious[CONTROL, "outline"] > 0.1
    assert leak.foreign_px > 600
    assert not leak.identical
    rows, columns = np.nonzero(own)
    cut_off = own.copy()
    cut_off[(rows.min() + rows.max()) // 2 :, : int(np.median(columns))] = False
    (bitten,) = attack_drive(drive, [rendition(drive, near, cut_off)], NOBODY_FOUND).frames
    assert bitten.outline_iou < 0.9


def test_a_picture_with_nobody_near_is_not_attacked(drive: Drive, near: Rendition) -> None:
    assert not attack_drive(drive, [replace(near, gap_px=float("inf"))], NOBODY_FOUND).frames


def test_what_has_no_control_is_counted(drive: Drive, near: Rendition, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("network.lab.hiding.moving.blank_attacks.watch", lambda *_: iter(()))
    report = attack_drive(drive, [near], NOBODY_FOUND)
    assert (report.frames, report.unattacked) == ([], Counter({CONTROL_NOT_CUT: 1}))


def test_a_blank_view_has_the_owners_relief_and_nothing_else(drive: Drive, near: Rendition) -> None:
    view = blank_view(spread_cutout(near.cutout, (480, 640)))
    assert not view.picture[~view.owner].any()
    assert not view.empty[~view.owner].any()
    assert abs(float(view.empty[view.owner][0]) - float(np.median(view.picture[view.owner]))) < 20
    assert not blank_view(np.zeros((480, 640), dtype=np.uint16)).owner.any()


def bitten_example(rng: np.random.Generator, *, bitten: bool) -> Example:
    """An owner out of whom somebody on one side has bitten, or who is whole."""
    kept, other = np.zeros((480, 640), dtype=np.uint16), np.zeros((480, 640), dtype=bool)
    left = int(rng.integers(200, 300))
    kept[120:420, left : left + 100] = np.rint(rng.normal(2_000, 8, (300, 100))).astype(np.uint16)
    side = slice(left + 70, left + 190) if rng.integers(2) else slice(left - 90, left + 30)
    other[160:420, side] = True
    if bitten:
        kept[other] = 0
    return Example(blank_view(kept), np.ascontiguousarray(other[::2, ::2]))


def test_an_attacker_learns_from_bites_where_the_other_is() -> None:
    rng = np.random.default_rng(3)
    attacker = train([bitten_example(rng, bitten=True) for _ in range(12)], seed=1, trees=15)

    def found(*, bitten: bool) -> float:
        made = [bitten_example(rng, bitten=bitten) for _ in range(6)]
        return float(np.mean([(attacker.recover(one.view) & one.others).sum() / one.others.sum() for one in made]))

    assert found(bitten=True) > found(bitten=False) + 0.2


def scored(ours: float, control: float, *, released: bool = True) -> BlankScore:
    score = BlankScore(released, 20.0, 0.98, 0, outline_iou=0.99)
    score.ious = {(way, name): 0.0 for way in (OURS, CONTROL) for name in ("bite", "outline", ON_OURS)}
    score.ious |= {(OURS, ON_OURS): ours, (CONTROL, ON_OURS): control}
    return score


def test_bounds_are_by_drive_and_a_goal_is_claimed_only_for_what_was_attacked() -> None:
    clean = [BlankReport([scored(0.2, 0.2)] * 3) for _ in range(20)]
    figures = summarise_attacks([*clean, BlankReport()], seed=1)
    assert (figures.attacked_scenes, figures.attacked_frames, figures.difference_upper95) == (20, 60, 0.0)
    assert (figures.found_scenes, figures.found_scenes_upper95) == (0, 0.1391)
    assert summarise_drives([], figures).goals[DIFFERENCE_GOAL]
    assert not summarise_drives([], summarise_attacks(clean[1:], seed=1)).goals[DIFFERENCE_GOAL], "too few drives"
    leaking = [BlankReport([scored(0.6, 0.2), scored(0.2, 0.2)]) for _ in range(5)]
    found = summarise_attacks([*clean, *leaking], seed=1)
    assert found.difference == pytest.approx(0.04)
    assert found.found_scenes == 5
    assert not summarise_drives([], found).goals[DIFFERENCE_GOAL]
    assert not summarise_drives([], summarise_attacks([BlankReport()], seed=1)).goals[DIFFERENCE_GOAL]
    assert not {DIFFERENCE_GOAL, NEIGHBOUR_GOAL} & summarise_drives([]).goals.keys()


def test_what_the_rule_withheld_counts_apart() -> None:
    figures = summarise_attacks([BlankReport([scored(0.2, 0.2), scored(0.9, 0.1, released=False)])], seed=1)
    assert (figures.attacked_frames, figures.withheld_frames) == (1, 1)
    assert figures.difference_upper95 == 0.0
    assert figures.withheld_attackers[ON_OURS].difference == 0.8


def clues(rng: np.random.Generator, *, tells: bool, people: int = 4) -> list[Clue]:
    """Of one drive; if it `tells`, each person makes other frames missing."""
    made = []
    for person in range(people):
        for take in range(TAKES_COUNT):
            missing = rng.random(FRAMES_COUNT) < 0.3
            if tells:
                missing = (np.arange(FRAMES_COUNT) + int(rng.integers(2))) % (3 + 2 * person) == 0
            made.append(Clue(person, take, missing, rng.normal(0, 1, 12).astype(np.float32)))
    return made


def test_a_pattern_that_tells_the_neighbour_misses_the_goal_and_noise_does_not_tell() -> None:
    rng = np.random.default_rng(5)
    told = summarise_neighbours([clues(rng, tells=True) for _ in range(10)], people=4, seed=1)
    assert min(told.attackers[name].rate for name in (PATTERN, PICTURES)) > 0.6
    assert not summarise_drives([], neighbours=told).goals[NEIGHBOUR_GOAL]
    noise = summarise_neighbours([*(clues(rng, tells=False) for _ in range(40)), []], people=4, seed=1)
    assert (noise.chance, noise.drives, noise.drives_without_pattern, noise.clips) == (0.25, 40, 1, 320)
    assert max(row.rate for row in noise.attackers.values()) < 0.33
    nothing = summarise_neighbours([[]], people=4, seed=1)
    assert nothing.rate_upper95 is None
    assert not summarise_drives([], neighbours=nothing).goals[NEIGHBOUR_GOAL]


def test_where_nothing_differs_who_knows_the_drive_guesses_too() -> None:
    missing = np.arange(FRAMES_COUNT) < 9
    same = [Clue(person, take, missing, np.zeros(3, np.float32)) for person in range(4) for take in range(TAKES_COUNT)]
    assert summarise_neighbours([same], people=4, seed=1).attackers[KNOWING].rate == 0.25


def test_the_nearest_person_is_replaced_and_all_else_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = draw_drive(5_100_006, "crowd", judging=False)
    near = neighbours._nearest_to(drive, 0)
    assert near is not None
    played: list[Drive] = []

    def show(one: Drive) -> list[Rendition]:
        played.append(one)
        out = encode_cutout(Cutout(10, 10, np.full((300, 80), 2_000, dtype=np.uint16)))
        kept = range(5, 30) if one.scenario.absent else range(5, 20)
        return [Rendition(sequence, 1, out, released=True, gap_px=20.0) for sequence in kept]

    monkeypatch.setattr(neighbours, "show_everybody", show)
    found = watch_neighbours(drive, 1, 3)
    assert [(clue.person, clue.take) for clue in found] == [(n, take) for n in range(3) for take in range(TAKES_COUNT)]
    assert not found[0].missing[5:20].any()
    assert found[0].missing[20:].all()
    assert played[1].scenario.absent == {drive.scenario.people[near].alias}
    assert len({one.scenario.seed for one in played[2:]}) == len(found)
    for one in played[2:]:
        pairs = zip(one.scenario.people, drive.scenario.people, strict=True)
        assert [place for place, (new, old) in enumerate(pairs) if new != old] == [near]
        assert one.scenario.people[near].path == drive.scenario.people[near].path
    monkeypatch.setattr(neighbours, "CHANGED_MIN_COUNT", 11)
    assert watch_neighbours(drive, 1, 3) == []


@pytest.fixture
def by_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def pool(*_: object) -> Iterator[Executor]:
        with ThreadPoolExecutor(1) as executor:
            yield executor

    def judge(seed: int, stratum: str, antennas: int, pairs: object, attacker: object) -> Judged:
        return Judged(DrivePlayed(stratum, seed), BlankReport([scored(0.9, 0.1)] if attacker else []))

    rng = np.random.default_rng(1)
    monkeypatch.setattr(evaluate_drives, "worker_pool", pool)
    monkeypatch.setattr(evaluate_drives, "_judge", judge)
    monkeypatch.setattr(evaluate_drives, "_learn", lambda *_: [bitten_example(rng, bitten=True) for _ in range(2)])
    monkeypatch.setattr(evaluate_drives, "_watch", lambda seed, *_: Watched(seed, clues(rng, tells=True)))


@pytest.mark.usefixtures("by_thread")
def test_the_judge_learns_attacks_and_fails_if_they_find_somebody(monkeypatch: pytest.MonkeyPatch) -> None:
    result = evaluate_drives.run_drive_benchmark(scenes=3, seed=1, learning_scenes=5, people=4)
    told = msgspec.to_builtins(result)
    assert told["figures"]["attacks"]["difference_upper95"] == 0.8
    assert told["figures"]["neighbours"]["drives"] == 5
    assert (told["figures"]["goals"][DIFFERENCE_GOAL], told["figures"]["goals"][NEIGHBOUR_GOAL]) == (False, False)
    assert not result.ok
    assert told["conditions"]["learning_scenes"] == 5
    with pytest.raises(BlockRobotError) as refused:
        evaluate_drives.run_drive_benchmark(scenes=3, seed=1, learning_scenes=3, people=4)
    assert refused.value.code == "CONFIGURATION_INVALID"


@pytest.mark.usefixtures("by_thread")
def test_without_drives_to_learn_from_nothing_is_attacked_or_claimed() -> None:
    result = evaluate_drives.run_drive_benchmark(scenes=3, seed=1)
    assert (result.figures.attacks, result.figures.neighbours) == (UNSET, UNSET)
    assert not {"attacks", "neighbours"} & msgspec.to_builtins(result)["figures"].keys()
    assert not {DIFFERENCE_GOAL, NEIGHBOUR_GOAL} & result.figures.goals.keys()
