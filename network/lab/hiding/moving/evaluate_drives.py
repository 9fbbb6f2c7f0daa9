"""Judges what a driving robot shows and keeps, on drives that nothing was learned from. Deterministic by seed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import replace

from clients.robot.sensing.antenna_pairs import AntennaPair
from clients.robot.synthetic.driving.draws import DRIVE_STRATA, DriveStratum, draw_drive
from network.bench.cluster import check_seeds
from network.bench.conditions import Result, count_cores, measure_conditions
from network.bench.processes import worker_pool
from network.lab.hiding.moving.drive_figures import MovingFigures, summarise_drives
from network.lab.hiding.moving.run_drive import DrivePlayed, run_drive
from network.lab.hiding.scenes import walk_calibration, with_antennas

STANDS_S = 12.0
SCENES_A_SEED_MAX_COUNT = 100_000
Progress = Callable[[str], None]


def run_drive_benchmark(
    scenes: int, seed: int, *, antennas: int = 0, processes: int = 0, on: str = "", progress: Progress = lambda _: None
) -> Result[MovingFigures]:
    """Half of the scenes have companions; `antennas`: of the reader, as `draw_scenes`. `ok`: every goal holds."""
    conditions = measure_conditions(nodes=0, seed=seed)
    processes = processes or count_cores()
    pairs = walk_calibration(antennas, seed) if antennas > 1 else ()
    played: list[DrivePlayed] = []
    with worker_pool(processes, on) as pool:
        seeds = range(seed * SCENES_A_SEED_MAX_COUNT, seed * SCENES_A_SEED_MAX_COUNT + scenes)
        jobs = [pool.submit(_judge, drive, _stratum(number), antennas, pairs) for number, drive in enumerate(seeds)]
        for done, future in enumerate(as_completed(jobs), start=1):
            played.append(future.result())
            progress(f"judged {done} of {scenes}")
    played.sort(key=lambda one: one.seed)
    check_seeds([one.seed for one in played], seeds)
    figures = summarise_drives(played)
    conditions |= {"scenes": scenes, "processes": on or processes, "frame": "640x480", "stands_s": STANDS_S}
    conditions |= {"antennas": antennas}
    return Result(name="hiding-moving", ok=all(figures.goals.values()), figures=figures, conditions=conditions)


def _stratum(number: int) -> DriveStratum:
    others = [name for name in DRIVE_STRATA if name != "companions"]
    return "companions" if number % 2 else others[number // 2 % len(others)]


def _judge(seed: int, stratum: DriveStratum, antennas: int, pairs: tuple[AntennaPair, ...]) -> DrivePlayed:
    drive = draw_drive(seed, stratum, judging=True, stands_s=STANDS_S)
    if antennas:
        drive = replace(drive, scenario=with_antennas(drive.scenario, antennas))
    return run_drive(drive, seed, pairs)
