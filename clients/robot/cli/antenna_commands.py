"""`blockrobot robot antennas`: measures how two antennas tell on which side a tag is."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

import click

from clients.robot.backgrounds.background_banks import approved_frames
from clients.robot.cli.live_options import live_options, notice_teller, open_live, source_option
from clients.robot.cli.robot_answers import RobotAntennaPair, RobotAntennasAnswer
from clients.robot.cli.robot_choice import RobotPlace
from clients.robot.cli.source_options import open_recording, source_options
from clients.robot.hiding.background import learn_background
from clients.robot.run.antenna_walk import AntennaWalk
from clients.robot.sensing.antenna_calibration import Calibration
from clients.robot.sensing.camera_intrinsics import FOCAL_DEFAULT_PX
from clients.robot.sources.live.live_source import LiveSource
from clients.robot.sources.source import StoppableClock, SystemClock
from clients.sdk.new_files import write_new_file
from clients.sdk.terminal.terminal import FILE, command_output, console, print_answer, print_line

WALK_DEFAULT_S, WALK_MAX_S = 180.0, 900.0


@click.command()
@click.argument("recording", type=click.Path(path_type=Path), required=False)
@source_option(help="Watch the walk now, by the robot's middleware, instead of in a RECORDING.")
@source_options
@live_options
@click.option("--viewpoint", default="", metavar="NAME", help="With --source: this viewpoint's approved empty frames.")
@click.option(
    "--seconds",
    default=WALK_DEFAULT_S,
    show_default=True,
    type=click.FloatRange(10, WALK_MAX_S),
    help="With --source: how long the walk takes.",
)
@click.option("--out", type=FILE, help="Write what to add to the topics file here; an existing file is left alone.")
@click.pass_obj
@command_output
def antennas(
    place: RobotPlace, /, recording: Path | None, viewpoint: str, out: Path | None, as_json: bool, **options: Any
) -> None:
    """Measure two antennas that look to different sides, by one person with one tag who walks before the camera.

    Three minutes, from one edge of the picture to the other and back, 1.5 to 4 m away, nobody else in view. The printed
    tables go into the topics file: readings of both antennas then say on which side a tag is.

    Example: blockrobot robot antennas walk.mcap --topics topics.toml --out antennas.toml
    """
    if (recording is None) == (options["source"] is None):
        raise click.UsageError("Give a RECORDING of the walk, or --source.")
    if recording is None:
        if not viewpoint:
            raise click.UsageError("With --source the empty frames are a viewpoint's: give --viewpoint NAME.")
        with open_live(options, notice_teller(as_json=as_json)) as source:
            walk = _watch_live(source, place, viewpoint, options["seconds"])
    else:
        recorded = open_recording(recording, options)
        walk = AntennaWalk(learn_background(recorded.empty_frames()), recorded.focal_px or FOCAL_DEFAULT_PX)
        walk.watch(recorded.events())
    found = walk.calibrate()
    if out is not None:
        write_new_file(out, as_toml(found))
    if as_json:
        pairs = [_answer(found, number) for number in range(len(found.pairs))]
        turn_deg = round(found.turn_deg, 1)
        print_answer(RobotAntennasAnswer(pairs=pairs, turn_deg=turn_deg, file=str(out) if out else None))
        return
    for line in as_toml(found).rstrip().split("\n"):
        print_line(line)
    if walk.several_count:
        console.print(f"{walk.several_count} frames showed more than one person and did not count.")
    where = f" {out} holds this." if out else ""
    console.print(f"Next: add these lines to the topics file.{where} Measure anew when an antenna was moved.")


def _watch_live(source: LiveSource, place: RobotPlace, viewpoint: str, seconds: float) -> AntennaWalk:
    frames = approved_frames(place.folder, viewpoint, time.time_ns() // 1_000_000)
    walk = AntennaWalk(learn_background(frames))

    async def watch() -> None:
        clock = StoppableClock(asyncio.Event(), SystemClock().now_ms() + round(seconds * 1000))
        async for event in source.play(clock):
            walk.focal_px = source.focal_px or FOCAL_DEFAULT_PX  # a live camera tells it once it runs
            walk.watch_one(event)

    asyncio.run(watch())
    return walk


def as_toml(found: Calibration) -> str:
    """Return the tables for a topics file, the most exact pair first."""
    lines = []
    for pair, count in zip(found.pairs, found.readings, strict=True):
        lines += [
            f"# {count} pairs of readings; the error of one bearing is {pair.sigma_deg:.0f} degrees.",
            "[[antenna_pairs]]",
            *([f"reader = {json.dumps(pair.reader)}"] if pair.reader else []),
            f"left = {pair.left}",
            f"right = {pair.right}",
            f"offset_db = {pair.offset_db}",
            f"slope_db_per_deg = {pair.slope_db_per_deg}",
            f"sigma_db = {pair.sigma_db}",
            "",
        ]
    return "\n".join(lines)


def _answer(found: Calibration, number: int) -> RobotAntennaPair:
    pair = found.pairs[number]
    return RobotAntennaPair(
        reader=pair.reader or None,
        left=pair.left,
        right=pair.right,
        offset_db=pair.offset_db,
        slope_db_per_deg=pair.slope_db_per_deg,
        sigma_db=pair.sigma_db,
        sigma_deg=round(pair.sigma_deg, 1),
        readings=found.readings[number],
    )
