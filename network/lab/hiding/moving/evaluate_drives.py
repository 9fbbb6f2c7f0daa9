"""Judges what a driving robot shows and keeps, on drives that nothing was learned from. Deterministic by seed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass, replace

from msgspec import UNSET

from clients.robot.sensing.antenna_pairs import AntennaPair
from clients.robot.synthetic.driving.draws import DRIVE_STRATA, DriveStratum, draw_drive
from consensus.errors import BlockRobotError
from network.bench.cluster import check_seeds
from network.bench.conditions import Result, count_cores, measure_conditions
from network.bench.processes import worker_pool
from network.lab.hiding.learned import Example, LearnedAttacker, require_learning, train
from network.lab.hiding.moving.blank_attacks import BlankReport, attack_drive, learn_from_drive, summarise_attacks
from network.lab.hiding.moving.drive_figures import MovingFigures, summarise_drives
from network.lab.hiding.moving.neighbours import Clue, summarise_neighbours, watch_neighbours
from network.lab.hiding.moving.run_drive import DrivePlayed, run_drive, show_everybody
from network.lab.hiding.scenes import walk_calibration, with_antennas

STANDS_S = 12.0
SCENES_A_SEED_MAX_COUNT = 100_000
EXAMPLES_MIN_COUNT = 8
_APART = tuple(name for name in DRIVE_STRATA if name != "companions")
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Judged:
    """A drive that was played, and its pictures as they were attacked."""

    played: DrivePlayed
    attacked: BlankReport


@dataclass(frozen=True, slots=True)
class Watched:
    """What tells of the neighbours of one drive."""

    seed: int
    clues: list[Clue]


def run_drive_benchmark(
    scenes: int,
    seed: int,
    *,
    antennas: int = 0,
    learning_scenes: int = 0,
    people: int = 8,
    processes: int = 0,
    on: str = "",
    progress: Progress = lambda _: None,
) -> Result[MovingFigures]:
    """Half of the scenes have companions. `ok`: every goal holds. `antennas`: of the reader, as `draw_scenes`.

    With `learning_scenes` attackers learn from so many other drives; `people`: among whom they look for the neighbour.

    Raises CLUSTER_RESULT_FOREIGN, CONFIGURATION_INVALID, EXTRA_MISSING.
    """
    conditions = measure_conditions(nodes=0, seed=seed)
    processes = processes or count_cores()
    pairs = walk_calibration(antennas, seed) if antennas > 1 else ()
    with worker_pool(processes, on) as pool:
        seeds = range(seed * SCENES_A_SEED_MAX_COUNT, seed * SCENES_A_SEED_MAX_COUNT + scenes)
        learned = range(seeds.start, seeds.start + learning_scenes)
        attacker = _train(pool, learned, seed, progress) if learned else None
        waiting: list[Future[Judged | Watched]] = []
        waiting += [
            pool.submit(_judge, drive, _stratum(number), antennas, pairs, attacker)
            for number, drive in enumerate(seeds)
        ]
        waiting += [pool.submit(_watch, drive, number, seed, people) for number, drive in enumerate(learned)]
        for done, future in enumerate(as_completed(waiting), start=1):
            future.result()
            progress(f"judged {done} of {len(waiting)}")
    found = [future.result() for future in waiting]
    judged = [one for one in found if isinstance(one, Judged)]
    watched = [one for one in found if isinstance(one, Watched)]
    check_seeds([one.played.seed for one in judged], seeds)
    check_seeds([one.seed for one in watched], learned)
    figures = summarise_drives(
        [one.played for one in judged],
        summarise_attacks([one.attacked for one in judged], seed) if learned else UNSET,
        summarise_neighbours([one.clues for one in watched], people, seed) if learned else UNSET,
    )
    conditions |= {"scenes": scenes, "processes": on or processes, "frame": "640x480", "stands_s": STANDS_S}
    conditions |= {"learning_scenes": learning_scenes, "antennas": antennas}
    return Result(name="hiding-moving", ok=all(figures.goals.values()), figures=figures, conditions=conditions)


def _stratum(number: int) -> DriveStratum:
    return "companions" if number % 2 else _APART[number // 2 % len(_APART)]


def _judge(
    seed: int,
    stratum: DriveStratum,
    antennas: int,
    antenna_pairs: tuple[AntennaPair, ...],
    attacker: LearnedAttacker | None,
) -> Judged:
    drive = draw_drive(seed, stratum, judging=True, stands_s=STANDS_S)
    if antennas:
        drive = replace(drive, scenario=with_antennas(drive.scenario, antennas))
    played = run_drive(drive, seed, antenna_pairs)
    if attacker is None:
        return Judged(played, BlankReport())
    drive = draw_drive(seed, stratum, judging=True)  # what is seen while the robot stands withholds much of the way
    return Judged(played, attack_drive(drive, show_everybody(drive), attacker))


def _train(pool: Executor, seeds: range, seed: int, progress: Progress) -> LearnedAttacker:
    require_learning()
    examples: list[Example] = []
    for done, some in enumerate(pool.map(_learn, seeds, range(len(seeds))), start=1):
        examples += some
        progress(f"played {done} of {len(seeds)} drives to learn from")
    if len(examples) < EXAMPLES_MIN_COUNT:
        raise BlockRobotError(
            "CONFIGURATION_INVALID", "So few drives to learn from show hardly anybody beside somebody."
        )
    return pool.submit(train, examples, seed=seed).result()


def _learn(seed: int, number: int) -> list[Example]:
    return learn_from_drive(draw_drive(seed, _stratum(number), judging=False))


def _watch(seed: int, number: int, first_seed: int, people: int) -> Watched:
    drive = draw_drive(seed, _APART[number % len(_APART)], judging=True)
    return Watched(seed, watch_neighbours(drive, first_seed, people))
