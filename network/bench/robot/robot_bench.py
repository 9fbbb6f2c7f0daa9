"""Whole-robot benchmark: recorded frames at camera pace, found by their owners.

Real robots, nodes and wallets; each robot is a process.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from msgspec import UNSET, Struct, UnsetType

from clients.robot.hiding.moving.driving_figures import DrivingFigures
from clients.robot.synthetic.driving.drive_file import DRIVE_TOPICS_FILE
from clients.robot.synthetic.scenario import Scenario
from clients.robot.synthetic.scenario_bag import load_or_draw_tags, make_bag
from network.bench.clips_apart import ClipsApart, removed_after
from network.bench.conditions import Condition, Result, measure_conditions, percentile
from network.bench.fresh_network import find_base_port
from network.bench.robot.robot_counts import (
    LoggedFrames,
    account_for_frames,
    caught_up_at_ms,
    read_frames,
    untouched_by_cut,
)
from network.bench.robot.robot_owners import OwnFrames, find_own_frames
from network.bench.robot.robot_player import PlayedSummary
from network.bench.robot.robot_scene import PEOPLE, is_in_place, loop_seconds, make_drive, make_scene
from network.demo.processes import LongCommand, Progress
from network.faults.actions import Heal, Pause
from network.faults.control import FaultControl
from network.testbed import NODES_COUNT, Stage

PURPOSE = "demo"
SETTLING_MAX_S = 600.0
"""How long a robot may take after its last frame: the buffer, what waited, and a busy machine."""

_MB = 1024 * 1024

OnProgress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class RobotOptions:
    """`cut_s` is the partition length, 0 for none; recordings are kept in `cache`; `apart`: where clips are kept; `drives`:
    the robots drive.
    """

    seconds: float
    robots: int
    fps: int
    cut_s: float
    seed: int
    cache: Path
    apart: ClipsApart | None = None
    drives: bool = False

    @property
    def frames(self) -> int:
        return round(self.seconds * self.fps)


@dataclass(slots=True)
class _Played:
    name: str
    member: bytes
    folder: Path
    frames_read: int = 0
    begun: asyncio.Event = field(default_factory=asyncio.Event)
    summary: PlayedSummary | None = None
    logged: LoggedFrames = field(default_factory=LoggedFrames)

    @property
    def log(self) -> Path:
        return self.folder / "events.jsonl"


@dataclass(slots=True)
class _Cut:
    """When nodes stood still, wall clock ms; zeros if never."""

    from_ms: int = 0
    until_ms: int = 0


async def run_robot_benchmark(options: RobotOptions, on_progress: OnProgress) -> Result[RobotFigures]:
    """A cut stops all nodes by SIGSTOP; connections stay open."""
    drawn = make_drive(options.fps, options.seed) if options.drives else None
    scene = drawn.scenario if drawn else make_scene(loop_seconds(options.seconds), options.fps, options.seed)
    tags = load_or_draw_tags(options.cache, scene)
    bag = await asyncio.to_thread(
        make_bag,
        drawn or scene,
        tags,
        options.cache,
        progress=lambda done, total: on_progress(f"rendering the recording: {done} of {total} frames"),
    )
    folder = Path(tempfile.mkdtemp(prefix="blockrobot-bench-"))
    stage = Stage(folder, store="sqlite", base_port=find_base_port(NODES_COUNT), purpose=PURPOSE)
    async with removed_after(folder, options.apart):
        try:
            on_progress("starting four nodes")
            await stage.start_network("bench-robot", options.apart.configure if options.apart else None)
            on_progress("registering people and robots")
            for alias in PEOPLE:
                await stage.enrol_person(alias, tags[alias])
            robots = [await _enrol(stage, number) for number in range(options.robots)]
            conditions = _conditions(options, scene)
            cut = await _play(stage, robots, bag, scene, options, on_progress)
            for robot in robots:
                with robot.log.open(encoding="utf-8") as lines:
                    robot.logged = await asyncio.to_thread(read_frames, lines)
            on_progress("looking with the owners' eyes")
            owners = await _look(stage)
        finally:
            await stage.stop()
    played = [(robot.member, robot.summary, robot.logged) for robot in robots if robot.summary is not None]
    figures = make_figures(options, played, owners, _cut_figures(robots, cut))
    return Result(name="robot", ok=is_good(figures), figures=figures, conditions=conditions)


def _conditions(options: RobotOptions, scene: Scenario) -> dict[str, Condition]:
    return measure_conditions(
        nodes=NODES_COUNT,
        seed=options.seed,
        robots=options.robots,
        seconds=options.seconds,
        fps=options.fps,
        picture=f"{scene.width}x{scene.height}, {len(scene.people)} registered people in view",
        recording_s=scene.duration_s,
        cut_s=options.cut_s,
        drives=options.drives,
        cut_by="SIGSTOP of all nodes" if options.cut_s else "",
        clips=options.apart.kind if options.apart else "store",
    )


async def _enrol(stage: Stage, number: int) -> _Played:
    name = f"robot-{number + 1}"
    member = await stage.enrol_robot(name)
    folder = stage.robots / name
    await stage.make_roster(member, folder / "roster.sealed")
    return _Played(name, bytes.fromhex(member), folder)


async def _play(
    stage: Stage, robots: list[_Played], bag: Path, scene: Scenario, options: RobotOptions, on_progress: OnProgress
) -> _Cut:
    loop_ms = round(scene.duration_s * 1000)

    async def play(robot: _Played) -> None:
        def progress(figures: Progress) -> None:
            robot.frames_read = figures.frames_read
            if robot.frames_read:
                robot.begun.set()
            least = min(one.frames_read for one in robots)
            on_progress(f"playing: {least} of {options.frames} frames, {figures.waiting} waiting")

        where = {"folder": robot.folder, "genesis": stage.genesis_file, "bag": bag, "events": robot.log}
        where["approver"] = stage.approver_file
        if options.drives:
            where["topics"] = DRIVE_TOPICS_FILE
        what = {"loop-ms": loop_ms, "frames": options.frames, "purpose": PURPOSE}
        arguments = [word for name, value in {**where, **what}.items() for word in (f"--{name}", str(value))]
        command = LongCommand(arguments, PlayedSummary, progress, module="network.bench.robot.robot_player")
        robot.summary = await command.run(options.seconds + options.cut_s + SETTLING_MAX_S)

    playing = [asyncio.create_task(play(robot)) for robot in robots]
    cutting = asyncio.create_task(_cut(stage, robots, options, on_progress))
    try:
        await asyncio.gather(*playing)
        return await cutting
    finally:
        for task in (*playing, cutting):
            task.cancel()
        await asyncio.gather(*playing, cutting, return_exceptions=True)


async def _cut(stage: Stage, robots: list[_Played], options: RobotOptions, on_progress: OnProgress) -> _Cut:
    if not options.cut_s:
        return _Cut()
    for robot in robots:
        await robot.begun.wait()
    await asyncio.sleep(max(0.0, (options.seconds - options.cut_s) / 2))
    control = FaultControl(stage.cluster)
    cut = _Cut(from_ms=_now_ms())
    on_progress("the network is cut")
    try:
        for name in stage.cluster.names:
            await control.carry_out(Pause(name))
        await asyncio.sleep(options.cut_s)
    finally:
        await control.carry_out(Heal(()))
    cut.until_ms = _now_ms()
    on_progress("the network is back")
    return cut


def _now_ms() -> int:
    return time.time_ns() // 1_000_000


async def _look(stage: Stage) -> list[OwnFrames]:
    found = []
    for alias in PEOPLE:
        passphrase = (stage.wallets / f"{alias}.passphrase").read_text(encoding="utf-8").strip()
        wallet, is_theirs = stage.wallets / f"{alias}.wallet", partial(is_in_place, alias)
        found.append(await find_own_frames(wallet, passphrase, stage.cluster.genesis, is_theirs))
    return found


class RobotFigures(Struct, kw_only=True):
    """What became of the frames of all robots, and what it cost."""

    frames_published: int
    frames_covered: int
    frames_kept: int
    frames_withheld: int
    frames_withheld_by_reason: dict[str, int]
    frames_found: int
    frames_lost: int
    frames_never_arrived: int
    frames_doubled: int
    frames_unexplained: int
    frames_misplaced: int
    frames_unreadable: int
    records: int
    records_found: int
    records_missing: int
    visits_unclosed: int
    frame_to_final_p50_ms: int
    frame_to_final_p95_ms: int
    frame_to_final_max_ms: int
    submit_to_final_p95_ms: float
    frames_per_s: float
    rss_peak_mb: float
    spool_peak_bytes: int
    stored_bytes_per_frame: int
    robot_cpu_share: float
    hiding_p50_ms: float
    hiding_p95_ms: float
    registry_stale_ms: int
    driving_frames: int | UnsetType = UNSET
    driving_kept: int | UnsetType = UNSET
    driving_kept_share: float | UnsetType = UNSET
    odometry_doubts: int | UnsetType = UNSET
    cut_caught_up_s: float | UnsetType = UNSET
    frame_to_final_without_cut_p95_ms: float | UnsetType = UNSET


def make_figures(
    options: RobotOptions,
    robots: list[tuple[bytes, PlayedSummary, LoggedFrames]],
    owners: list[OwnFrames],
    cut: dict[str, Any],
) -> RobotFigures:
    frames = [summary.frames for _, summary, _ in robots]
    reckonings = [
        account_for_frames(logged, [owner.frames.get(member, Counter()) for owner in owners])
        for member, _, logged in robots
    ]
    published = sum(one.published for one in frames)
    kept = sum(one.kept for one in frames)
    reasons: Counter[str] = Counter()
    for one in frames:
        reasons.update(one.withheld_reasons)
    known = {member for member, _, _ in robots}
    strange = sum(found.total() for owner in owners for member, found in owner.frames.items() if member not in known)
    took = [time.took_ms for _, _, logged in robots for time in logged.times]
    costs = [summary.process for _, summary, _ in robots]
    return RobotFigures(
        frames_published=published,
        frames_covered=sum(one.covered for one in frames),
        frames_kept=kept,
        frames_withheld=sum(one.withheld for one in frames),
        frames_withheld_by_reason=dict(sorted(reasons.items())),
        frames_found=sum(found.total() for owner in owners for found in owner.frames.values()),
        frames_lost=sum(one.lost for one in reckonings),
        frames_never_arrived=options.frames * options.robots - published,
        frames_doubled=sum(one.doubled for one in reckonings),
        frames_unexplained=sum(one.unexplained for one in reckonings) + strange,
        frames_misplaced=sum(owner.misplaced_frames for owner in owners),
        frames_unreadable=sum(owner.bad_frames for owner in owners),
        records=sum(summary.records for _, summary, _ in robots),
        records_found=sum(owner.record_count for owner in owners),
        records_missing=sum(owner.missing_records for owner in owners),
        visits_unclosed=sum(owner.unclosed_visits for owner in owners),
        frame_to_final_p50_ms=round(percentile(took, 0.50)),
        frame_to_final_p95_ms=round(percentile(took, 0.95)),
        frame_to_final_max_ms=max(took, default=0),
        submit_to_final_p95_ms=max(summary.latency_ms.submit_to_final.p95 for _, summary, _ in robots),
        frames_per_s=round(min(logged.frames_per_s for _, _, logged in robots), 2),
        rss_peak_mb=round(max(cost.rss_peak_bytes for cost in costs) / _MB, 1),
        spool_peak_bytes=max(summary.spool_peak_bytes for _, summary, _ in robots),
        stored_bytes_per_frame=round(sum(summary.stored_bytes for _, summary, _ in robots) / max(1, kept)),
        robot_cpu_share=round(max(cost.cpu_s / cost.seconds for cost in costs), 3),
        hiding_p50_ms=max(summary.hiding_ms.p50 for _, summary, _ in robots),
        hiding_p95_ms=max(summary.hiding_ms.p95 for _, summary, _ in robots),
        registry_stale_ms=max(summary.consents.stale_ms for _, summary, _ in robots),
        **_driving_figures([summary.driving for _, summary, _ in robots if summary.driving is not None]),
        **cut,
    )


def _driving_figures(driven: list[DrivingFigures]) -> dict[str, Any]:
    """Of the frames without the empty scene: `driving_kept` counts each owner's, of `PEOPLE` in every frame."""
    if not driven:
        return {}
    frames, kept = sum(one.frames for one in driven), sum(one.kept for one in driven)
    return {
        "driving_frames": frames,
        "driving_kept": kept,
        "driving_kept_share": round(kept / max(1, frames * len(PEOPLE)), 3),
        "odometry_doubts": sum(one.doubts for one in driven),
    }


def is_good(figures: RobotFigures) -> bool:
    """Each kept frame was found exactly once, by its owner alone; if the robot drove, some were kept on the way."""
    is_whole = figures.frames_found == figures.frames_kept > 0 and figures.records_found == figures.records
    is_whole = is_whole and figures.driving_kept != 0
    return is_whole and not (
        figures.frames_lost
        or figures.frames_never_arrived
        or figures.frames_doubled
        or figures.frames_unexplained
        or figures.frames_misplaced
        or figures.frames_unreadable
        or figures.records_missing
        or figures.visits_unclosed
    )


def _cut_figures(robots: list[_Played], cut: _Cut) -> dict[str, Any]:
    if not cut.until_ms:
        return {}
    times = [time for robot in robots for time in robot.logged.times]
    caught_up = caught_up_at_ms(times, cut.until_ms)
    rest = [time.took_ms for time in untouched_by_cut(times, cut.from_ms, caught_up)]
    return {
        "cut_caught_up_s": round((caught_up - cut.until_ms) / 1000, 3),
        "frame_to_final_without_cut_p95_ms": round(percentile(rest, 0.95)),
    }
