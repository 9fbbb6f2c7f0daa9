"""`blockrobot robot`: a robot on the command line."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import msgspec
from msgspec import UNSET, UnsetType

from clients.robot.cli.antenna_commands import antennas
from clients.robot.cli.background_commands import background
from clients.robot.cli.live_options import SYNTHETIC, live_options, notice_teller, open_live, source_option
from clients.robot.cli.reading_warnings import warn_of_lens, warn_of_odometry, warn_of_readings, warn_of_silence
from clients.robot.cli.robot_answers import (
    RobotNewAnswer,
    RobotPassphraseAnswer,
    RobotRegisterAnswer,
    RobotRunAnswer,
    RobotRunEndedAnswer,
)
from clients.robot.cli.robot_choice import (
    CREDENTIAL,
    ROBOT_COMMAND,
    RobotPlace,
    describe_refusal,
    name_robot,
    read_passphrase,
)
from clients.robot.cli.run_report import (
    broken_line,
    broken_off,
    clear_line,
    ended_line,
    ending_line,
    summary_lines,
    waiting_line,
)
from clients.robot.cli.source_options import open_recording, source_options, topic_options
from clients.robot.cli.topics_commands import topics
from clients.robot.delivery.robot_network import COPIES_DEFAULT_COUNT, COPIES_MAX_COUNT
from clients.robot.identity.robot_keys import change_passphrase, create_identity, register_robot
from clients.robot.recording.batching import CLIP_DEFAULT_MS
from clients.robot.recording.spool import count_waiting
from clients.robot.run.run_summary import RunProgress, RunSummary
from clients.robot.run.runner import SPOOL_FOLDER, ReplayOptions, replay_recording
from clients.robot.sources.live.live_source import LiveSource
from clients.robot.sources.live.synthetic_source import SyntheticSource
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.sources.source import Source
from clients.robot.synthetic.scenario import load_scenario, published_run_1
from clients.robot.synthetic.scenario_bag import load_or_draw_tags
from clients.sdk.terminal.json_answers import Problem, extend
from clients.sdk.terminal.own_command import called_with
from clients.sdk.terminal.qr_codes import read_given
from clients.sdk.terminal.safe_output import escape, overwrite_line
from clients.sdk.terminal.terminal import (
    EXISTING_FILE,
    EXIT_FAILED,
    FILE,
    FOLDER,
    command_output,
    console,
    home_folder,
    load_genesis,
    print_answer,
    print_line,
    problem_json,
    set_error_formatter,
)
from consensus.chain.genesis import Genesis
from consensus.exit_codes import EXIT_DONE, exit_code_of

_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_NAME_DEFAULT = "robot"
_RATE_DEFAULT = 10
_ROSTER_FILE = "roster.sealed"


@click.group()
@click.option("--name", default=_NAME_DEFAULT, show_default=True, help="Which robot, if there are several.")
@click.option("--robot-dir", type=FOLDER, help="The folder of robots.")
@click.option("--genesis", type=FILE, help="The network's genesis file.")
@click.option(
    "--passphrase-file",
    type=EXISTING_FILE,
    help="The first line of this file opens the robot's key file, if that is sealed.",
)
@click.pass_context
def robot(
    ctx: click.Context, name: str, robot_dir: Path | None, genesis: Path | None, passphrase_file: Path | None
) -> None:
    """Record people who carry a tag, each for themselves alone.

    Example: blockrobot robot new; blockrobot robot register BR1-...; blockrobot robot replay recording.mcap
    """
    if not name.replace("-", "").replace("_", "").isalnum():
        raise click.UsageError("A robot's name has letters, digits, - and _ only.")
    folder = (robot_dir or home_folder() / "robots") / name
    given = [
        ("--name", None if name == _NAME_DEFAULT else name),
        ("--robot-dir", robot_dir),
        ("--genesis", genesis),
        ("--passphrase-file", passphrase_file),
    ]
    network = genesis or home_folder() / "network" / "genesis.json"
    ctx.obj = RobotPlace(folder, network, passphrase_file, called_with(ROBOT_COMMAND, given))
    set_error_formatter(ctx, describe_refusal)


@robot.command()
@click.pass_obj
@command_output
def new(place: RobotPlace, as_json: bool) -> None:
    """Draw a robot's keys. With `robot --passphrase-file FILE` they are sealed under it.

    Example: blockrobot robot new --json
    """
    folder, file = place.folder, place.passphrase_file
    identity = create_identity(folder, None if file is None else read_passphrase(file))
    member = identity.identity.public_key.hex()
    if as_json:
        print_answer(RobotNewAnswer(folder=str(folder), member=member, sealed=file is not None))
    else:
        console.print(f"A robot lives in {escape(str(folder))}. Its member key: {member}")
        desk = "(at the desk, blockrobot card issue --role robot prints one)"
        print_line(name_robot(f"Next: {ROBOT_COMMAND} register CODE {desk}."))


@robot.command()
@click.option("--new-file", type=EXISTING_FILE, help="A file with the new passphrase.")
@click.option("--none", "to_none", is_flag=True, help="Leave the key file open, for a robot that starts by itself.")
@click.pass_obj
@command_output
def passphrase(place: RobotPlace, new_file: Path | None, to_none: bool, as_json: bool) -> None:
    """Seal the robot's key file under a passphrase, change it, or take it away.

    Example: blockrobot robot passphrase --new-file robot.pass
    """
    if (new_file is None) == (not to_none):
        raise click.UsageError("Give --new-file FILE, or --none.")
    change_passphrase(place.folder, place.find_passphrase(), None if new_file is None else read_passphrase(new_file))
    if as_json:
        print_answer(RobotPassphraseAnswer(sealed=not to_none))
    elif to_none:
        console.print("The key file is open: whoever steals the robot has its keys until it is revoked.")
    else:
        console.print(
            "The key file is sealed. Start the robot with --passphrase-file FILE, from systemd with "
            f"LoadCredential={CREDENTIAL}:FILE, or at a terminal. If the passphrase is lost, so are the robot's keys.",
            markup=False,
        )


@robot.command()
@click.argument("code")
@click.pass_obj
@command_output
def register(place: RobotPlace, code: str, as_json: bool) -> None:
    """Register the robot with the CODE that the registrar issued: its letters, or @FILE with them or a picture of the card.

    Example: blockrobot robot register BR1-...
    """
    folder = place.folder
    done = asyncio.run(register_robot(folder, place.load(), read_given(code), load_genesis(place.genesis)))
    if as_json:
        txid = done.txid.hex() if done.txid else None
        print_answer(RobotRegisterAnswer(txid=txid, member=done.member.hex()))
    else:
        before = "" if done.txid else " with this card already"
        console.print(f"The robot is registered{before}. Next: its roster of today, at the registrar's desk:")
        console.print(f"  blockrobot roster make --robot {done.member.hex()} --out {_ROSTER_FILE}")
        console.print(f"Then put it here as {escape(str(folder / _ROSTER_FILE))}.", soft_wrap=True)


class _Progress:
    """Progress: JSON lines on standard error, or one updating line; `figures` are newest."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self.figures = RunProgress()

    def __call__(self, figures: RunProgress, *, last: bool = False) -> None:
        self.figures = figures
        if self._as_json:
            click.echo(json.dumps({"progress": msgspec.to_builtins(figures)}), err=True)
        elif sys.stderr.isatty():
            line = (
                f"{figures.frames_read} frames, {figures.frames_recorded} recorded (counted for each owner), "
                f"{figures.waiting} clips waiting"
            )
            overwrite_line(line, ends=last)


def _common(command: Any) -> Any:
    for option in (
        click.option("--roster", type=FILE, help="The robot's sealed roster."),
        click.option("--purpose", default="demo", show_default=True, help="What the recording is for."),
        click.option("--clip-ms", default=CLIP_DEFAULT_MS, show_default=True, type=click.IntRange(0, 2_000)),
        click.option("--events", type=FILE, help="Append the event log here."),
        click.option(
            "--now", "at_once", is_flag=True, help="Submit without random delay. This links owners of a scene."
        ),
        click.option(
            "--copies",
            default=COPIES_DEFAULT_COUNT,
            show_default=True,
            type=click.IntRange(1, COPIES_MAX_COUNT),
            help="Record a clip once so many custodians have it, or all where there are fewer.",
        ),
        click.option("--viewpoint", default="", metavar="NAME", help="Use this viewpoint's approved empty frames."),
        click.option(
            "--approve-as",
            metavar="ORG",
            help="For trials: first approve the empty frames on the chain, with ORG's key beside the genesis file.",
        ),
    ):
        command = option(command)
    return command


@contextlib.contextmanager
def _stopped_by_signals(stop: asyncio.Event, on_stop: Callable[[], None]) -> Iterator[None]:
    """First SIGINT or SIGTERM sets `stop` and calls `on_stop`; the next cancels."""
    loop = asyncio.get_running_loop()
    task = asyncio.current_task(loop)
    assert task is not None

    def on_signal() -> None:
        if stop.is_set():
            task.cancel()
        else:
            stop.set()
            on_stop()

    for number in _STOP_SIGNALS:
        loop.add_signal_handler(number, on_signal)
    try:
        yield
    finally:
        for number in _STOP_SIGNALS:
            loop.remove_signal_handler(number)


async def _record(
    folder: Path, source: Source, genesis: Genesis, options: ReplayOptions, progress: _Progress
) -> tuple[RunSummary, bool]:
    stop, was_stopped = asyncio.Event(), False

    def on_stop() -> None:
        nonlocal was_stopped
        was_stopped = True
        click.echo(ending_line(progress.figures), err=True)

    with _stopped_by_signals(stop, on_stop):
        return await replay_recording(folder, source, genesis, options, progress, stop), was_stopped


def _replay(ctx: click.Context, source: Source, as_json: bool, options: dict[str, Any]) -> None:
    place: RobotPlace = ctx.obj
    folder, tell = place.folder, notice_teller(as_json=as_json)
    chosen = ReplayOptions(
        passphrase=place.find_passphrase(),
        roster=options["roster"] or folder / _ROSTER_FILE,
        purpose=options["purpose"],
        clip_ms=options["clip_ms"],
        events=options["events"] or folder / "events.jsonl",
        at_once=options["at_once"],
        real_time=not options.get("fast"),
        viewpoint=options["viewpoint"],
        lasts_s=options.get("seconds"),
        copies=options["copies"],
        approver=place.get_approver(options["approve_as"]),
        tell=tell,
    )
    if chosen.at_once and not as_json:
        click.echo("--now: owners of one scene stand side by side on the chain.", err=True)
    warnings = list(warn_of_readings(source.topics)) if isinstance(source, BagSource | LiveSource) else []
    if isinstance(source, BagSource):  # a live camera tells its focal length once it runs
        warnings += [*warn_of_silence(source.silent_tag_topics), *warn_of_lens(source.focal_px)]
        warnings += warn_of_odometry(source.unnamed_odometry, source.odometry_rate_hz)
    for warning in warnings:
        tell(warning)
    waiting_count = count_waiting(folder / SPOOL_FOLDER)
    if waiting_count and not as_json:
        click.echo(waiting_line(waiting_count), err=True)
    progress = _Progress(as_json=as_json)
    try:
        summary, was_ended = asyncio.run(_record(folder, source, load_genesis(place.genesis), chosen, progress))
    except asyncio.CancelledError:
        is_live = ctx.command.name == "run"
        _tell_broken(folder / SPOOL_FOLDER, progress.figures, as_json=as_json, is_live=is_live)
        sys.exit(EXIT_FAILED)
    fault = summary.intake.fault
    error = None if fault is None else broken_off(fault)
    if as_json:
        problem = UNSET if error is None else Problem(**problem_json(error))
        answer = extend(RobotRunAnswer, summary, error=problem)
        print_answer(answer, ok=_count_lost(summary) == 0 and error is None)
        sys.exit(EXIT_DONE if error is None else exit_code_of(error.entry))
    for line in summary_lines(summary, _silent_tag_topics(source, summary)):
        print_line(line)
    if was_ended:
        console.print(ended_line())
    if error is not None:
        raise error


def _tell_broken(spool: Path, figures: RunProgress, *, as_json: bool, is_live: bool) -> None:
    waiting = count_waiting(spool)
    if as_json:
        print_answer(RobotRunEndedAnswer(ended="at-once", progress=figures, spooled_clips=waiting), ok=False)
    clear_line()
    click.echo(broken_line(figures, waiting, str(spool), is_live=is_live), err=True)


def _silent_tag_topics(source: Source, summary: RunSummary) -> list[str]:
    """If no topic had a reading, all of them."""
    if isinstance(source, LiveSource) and not isinstance(summary.intake.heard, UnsetType):
        topics = [tags.topic for tags in source.topics.tags]
        silent = [topic for topic in topics if not summary.intake.heard.get(topic)]
        return silent if len(silent) == len(topics) and not source.topics.llrp else []
    if isinstance(source, BagSource) and not source.sighting_count:
        return source.silent_tag_topics
    return []


def _count_lost(summary: RunSummary) -> int:
    lost = sum(counts.lost for counts in (summary.frames, *summary.senses.values()))
    never_read = (summary.intake.missed, summary.intake.never_came)
    return lost + sum(sum(counts.values()) for counts in never_read if not isinstance(counts, UnsetType))


robot.add_command(topics)
robot.add_command(antennas)
robot.add_command(background)


@robot.command()
@click.argument("recording", type=click.Path(path_type=Path))
@source_options
@_common
@click.option("--fast", is_flag=True, help="Read as fast as possible; times of frames then run ahead of the clock.")
@click.pass_context
@command_output
def replay(ctx: click.Context, /, recording: Path, as_json: bool, **options: Any) -> None:
    """Record from a ROS bag (ROS 1 .bag, rosbag2 folder, .mcap or .db3), in real time unless --fast is given.

    Ctrl-C ends it in good order, as the recording's end does.

    Example: blockrobot robot replay recording.mcap --topics topics.toml --fast
    """
    _replay(ctx, open_recording(recording, options), as_json, options)


@robot.command()
@source_option(SYNTHETIC, default=SYNTHETIC, show_default=True, help="What to look at and listen to.")
@topic_options
@live_options
@click.option("--seconds", type=click.FloatRange(min=1), help="End after so long. [default: at Ctrl-C]")
@click.option(
    "--rate",
    default=_RATE_DEFAULT,
    show_default=True,
    type=click.IntRange(1, 30),
    help="Frames a second of the synthetic corridor, at most.",
)
@click.option("--scenario", type=FILE, help="Who walks in the synthetic corridor. [default: the published first run]")
@_common
@click.pass_context
@command_output
def run(ctx: click.Context, /, as_json: bool, **options: Any) -> None:
    """Record live until Ctrl-C: from a robot's own middleware, or from a synthetic corridor with people in it.

    A robot's camera needs approved frames of the empty scene (--viewpoint). No frame is written as it came. Ctrl-C ends the
    run in good order: what was seen is recorded, and visits are closed.

    Example: blockrobot robot run --source ros1 --topics topics.toml --viewpoint ward-3
    """
    if options["source"] != SYNTHETIC:
        if not options["viewpoint"]:
            raise click.UsageError(
                "A live camera needs --viewpoint NAME, a bank of approved frames without people. Record one with "
                + name_robot(f"{ROBOT_COMMAND} background record --source {options['source']} --viewpoint NAME.")
            )
        with open_live(options, notice_teller(as_json=as_json)) as source:
            _replay(ctx, source, as_json, options)
        return
    scenario = load_scenario(options["scenario"]) if options["scenario"] else published_run_1()
    tags = load_or_draw_tags(home_folder() / "recordings", scenario)
    _replay(ctx, SyntheticSource(scenario, tags, frames_per_s=options["rate"], endless=True), as_json, options)
