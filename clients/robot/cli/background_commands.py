"""`blockrobot robot background`: record, list and approve empty frames."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from clients.robot.backgrounds.background_banks import (
    VALID_DEFAULT_DAYS,
    VALID_MAX_DAYS,
    EmptyScene,
    approve_scene,
    get_scene,
    list_scenes,
    record_scene,
)
from clients.robot.cli.live_options import look_options, notice_teller, open_camera
from clients.robot.cli.robot_answers import RobotViewpointAnswer, RobotViewpointsAnswer
from clients.robot.cli.robot_choice import ROBOT_COMMAND, name_robot
from clients.robot.cli.source_options import open_recording, source_options
from clients.robot.identity.robot_keys import is_sealed
from clients.robot.sensing.sensor_events import Depth
from clients.robot.sources.live.live_sampling import record_empty_frames
from clients.sdk.terminal.terminal import can_ask, command_output, console, print_answer, print_line
from pages.time_format import format_time


@click.group()
def background() -> None:
    """Keep frames of the empty scene for each viewpoint, approved by a person for some time.

    Example: blockrobot robot background record empty.mcap --viewpoint ward-3
    """


@background.command("record")
@click.argument("recording", type=click.Path(path_type=Path), required=False)
@click.option("--viewpoint", required=True, metavar="NAME", help="Where the robot stands and looks.")
@look_options(
    source_help="Take the frames from the robot's camera as it looks now, instead of from a RECORDING.",
    seconds_help="Look at the robot's camera for so long.",
)
@source_options
@click.pass_context
@command_output
def record_command(
    ctx: click.Context, /, recording: Path | None, viewpoint: str, as_json: bool, **options: Any
) -> None:
    """Take a viewpoint's empty frames from a recording, or from the camera now, in place of older ones.

    They need an approval before use.

    Example: blockrobot robot background record empty.mcap --viewpoint ward-3 --empty-seconds 0..5
    """
    folder = ctx.obj.folder
    is_sealed(folder)  # raises if there is no robot
    frames = _recorded_frames(recording, options) if recording else _live_frames(options, as_json=as_json)
    scene = record_scene(folder, viewpoint, frames, _now_ms())
    if as_json:
        print_answer(_viewpoint(scene))
    else:
        print_line(f"{scene.frame_count} frames. Look at {scene.preview}: is nobody in it?")
        print_line(name_robot(f"Next: {ROBOT_COMMAND} background approve {viewpoint} --by YOUR-NAME."))


def _recorded_frames(recording: Path, options: dict[str, Any]) -> list[Depth]:
    if options["source"]:
        raise click.UsageError("Give a RECORDING or --source, not both.")
    return open_recording(recording, options).empty_frames()


def _live_frames(options: dict[str, Any], *, as_json: bool) -> list[Depth]:
    if not options["source"]:
        raise click.UsageError("Name a RECORDING, or with --source the robot's middleware to take the frames from.")
    if any(options[name] is not None for name in ("empty_topic", "empty_seconds", "empty_recording")):
        raise click.UsageError("With --source the frames are those that come now: leave the --empty options out.")
    with open_camera(options, notice_teller(as_json=as_json)) as source:
        return record_empty_frames(source, options["seconds"])


@background.command("list")
@click.pass_context
@command_output
def list_command(ctx: click.Context, as_json: bool) -> None:
    """List the viewpoints of a robot with who approved their empty frames, and until when.

    Example: blockrobot robot background list --json
    """
    folder = ctx.obj.folder
    rows = [_viewpoint(scene) for scene in list_scenes(folder)]
    if as_json:
        print_answer(RobotViewpointsAnswer(viewpoints=rows))
        return
    for row in rows:
        by = f"approved by {row.approved_by} until {format_time(row.expires_at_ms)}" if row.approved_by else ""
        state = "" if row.state == "approved" else row.state
        console.print(f"{row.viewpoint}: {row.frames} frames, {', '.join(filter(None, (state, by)))}")
    if not rows:
        print_line(name_robot(f"There are none. Next: {ROBOT_COMMAND} background record RECORDING --viewpoint NAME."))


@background.command("approve")
@click.argument("viewpoint")
@click.option("--by", required=True, metavar="PERSON", help="Who looked at the frames.")
@click.option(
    "--days",
    default=VALID_DEFAULT_DAYS,
    show_default=True,
    type=click.IntRange(1, VALID_MAX_DAYS),
    help="For how long.",
)
@click.option("--yes", is_flag=True, help="Do not ask whether nobody is in the picture.")
@click.pass_context
@command_output
def approve_command(ctx: click.Context, viewpoint: str, by: str, days: int, yes: bool, as_json: bool) -> None:
    """Say that you have looked at a viewpoint's empty frames, and that nobody is in them.

    Example: blockrobot robot background approve ward-3 --by "A. Nurse" --days 30
    """
    folder = ctx.obj.folder
    scene = get_scene(folder, viewpoint)
    if not yes:
        if not can_ask():
            detail = (
                f"There is no terminal to ask whether you have looked at {scene.preview}: look at it, and give --yes."
            )
            raise click.UsageError(detail)
        click.confirm(f"Have you looked at {scene.preview}, and is nobody in it?", abort=True, err=True)
    approved = approve_scene(folder, viewpoint, by=by, days=days, now_ms=_now_ms())
    if as_json:
        print_answer(_viewpoint(approved))
    else:
        console.print(f"{viewpoint} is approved until {format_time(approved.expires_at_ms)}.")


def _now_ms() -> int:
    return time.time_ns() // 1_000_000


def _viewpoint(scene: EmptyScene) -> RobotViewpointAnswer:
    return RobotViewpointAnswer(
        viewpoint=scene.viewpoint,
        state=scene.state(_now_ms()),
        frames=scene.frame_count,
        approved_by=scene.approved_by,
        expires_at_ms=scene.expires_at_ms,
        preview=str(scene.preview),
        digest=scene.digest,
    )
