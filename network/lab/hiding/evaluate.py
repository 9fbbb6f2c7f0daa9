"""The hiding judge: draws scenes, trains attackers on others, attacks releases. Deterministic per seed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass

from msgspec import UNSET

from network.bench.cluster import check_seeds
from network.bench.conditions import Result, count_cores, measure_conditions
from network.bench.processes import worker_pool
from network.lab.hiding.attacks import ON_OURS, ON_RAW, Examples, SceneReport, judge_scene, learn_from
from network.lab.hiding.companions import judge_companions
from network.lab.hiding.figures import HidingFigures, summarise
from network.lab.hiding.gait import GaitReport, judge_gait
from network.lab.hiding.learned import LearnedAttacker, require_learning, train
from network.lab.hiding.scenes import JUDGING, LEARNING, draw_scenes
from network.lab.matcher.matcher_evaluation import judge_matcher

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class HidingOptions:
    """Number of scenes and seeds, first seed, number of processes."""

    scenes: int = 200
    learning_scenes: int = 40  # for each seed
    seeds: int = 5
    seed: int = 1
    processes: int = 0
    on: str = ""  # a cluster's scheduler that does the work instead
    people: int = 8  # in each population of the re-identification
    matcher_tracks: int = 0  # also judge the matcher alone on so many drawn tracks
    companion_scenes: int = 0  # also judge the cues for companions on so many scenes of each kind
    antennas: int = 0  # of the reader that hears the tags to the sides; 0: one that tells front and back


def run_hiding_benchmark(options: HidingOptions, progress: Progress = lambda _: None) -> Result[HidingFigures]:
    """`ok`: every scene was judged and every goal holds. Raises CLUSTER_RESULT_FOREIGN, EXTRA_MISSING."""
    require_learning()
    conditions = measure_conditions(nodes=0, seed=options.seed)
    processes = options.processes or count_cores()
    seeds = range(options.seed, options.seed + options.seeds)
    reports: list[SceneReport] = []
    gaits: list[GaitReport] = []
    with worker_pool(processes, options.on) as pool:
        attackers = _train_all(pool, seeds, options.learning_scenes, progress)
        waiting: list[Future[SceneReport | GaitReport]] = []
        waiting += [pool.submit(judge_gait, seed, options.people, attackers[seed]) for seed in seeds]
        drawn: list[tuple[int, int]] = []
        for seed, count in zip(seeds, _shares(options.scenes, options.seeds), strict=True):
            scenes = draw_scenes(seed, count, JUDGING, antennas=options.antennas)
            drawn += [(scene.seed, scene.number) for scene in scenes]
            waiting += [pool.submit(judge_scene, scene, attackers[seed]) for scene in scenes]
        for done, future in enumerate(as_completed(waiting), start=1):
            result = future.result()
            if isinstance(result, GaitReport):
                gaits.append(result)
            else:
                reports.append(result)
            progress(f"judged {done} of {len(waiting)}")
    reports.sort(key=lambda report: (report.seed, report.number))
    gaits.sort(key=lambda report: report.seed)
    check_seeds([(report.seed, report.number) for report in reports], sorted(drawn))
    check_seeds([gait.seed for gait in gaits], seeds)
    figures = summarise(reports, gaits, seed=options.seed)
    _judge_parts(figures, options, processes, progress)
    conditions |= {
        "scenes": len(reports),
        "seeds": options.seeds,
        "learning_scenes_a_seed": options.learning_scenes,
        "processes": options.on or processes,
        "antennas": options.antennas,
        "frame": "640x480",
    }
    ok = len(reports) == options.scenes and holds(figures)
    return Result(name="hiding", ok=ok, figures=figures, conditions=conditions)


def holds(figures: HidingFigures) -> bool:
    parts = [part["ok"] for part in (figures.matcher, figures.companions) if part is not UNSET]
    return all(figures.goals.values()) and all(parts)


def _judge_parts(figures: HidingFigures, options: HidingOptions, processes: int, progress: Progress) -> None:
    if options.matcher_tracks:
        matcher = judge_matcher(
            options.matcher_tracks,
            options.seed,
            workers=processes,
            on=options.on,
            progress=lambda done, of: progress(f"judged {done} of {of} hundreds of the matcher's tracks"),
        )
        figures.matcher = {"ok": matcher.ok, **matcher.figures}
    if options.companion_scenes:
        progress("judging the cues for companions")
        companions = judge_companions(options.seed, scenes=options.companion_scenes, workers=processes, on=options.on)
        figures.companions = {"ok": companions.ok, **companions.figures}


def _shares(total: int, parts: int) -> list[int]:
    return [total // parts + (part < total % parts) for part in range(parts)]


def _train_all(pool: Executor, seeds: range, scenes: int, progress: Progress) -> dict[int, dict[str, LearnedAttacker]]:
    drawn = [scene for seed in seeds for scene in draw_scenes(seed, scenes, LEARNING)]
    learned: dict[int, list[Examples]] = {seed: [] for seed in seeds}
    for done, (scene, examples) in enumerate(zip(drawn, pool.map(learn_from, drawn), strict=True), start=1):
        learned[scene.seed].append(examples)
        progress(f"rendered {done} of {len(drawn)} scenes to learn from")
    jobs = {}
    for seed, found in learned.items():
        jobs[seed, ON_RAW] = pool.submit(train, [one for some in found for one in some.raw], seed=seed)
        jobs[seed, ON_OURS] = pool.submit(train, [one for some in found for one in some.ours], seed=seed)
    attackers: dict[int, dict[str, LearnedAttacker]] = {seed: {} for seed in seeds}
    for done, ((seed, name), job) in enumerate(jobs.items(), start=1):
        attackers[seed][name] = job.result()
        progress(f"trained {done} of {len(jobs)} attackers")
    return attackers
