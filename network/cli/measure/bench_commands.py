"""`blockrobot bench`: figures of what the network does."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import msgspec
from rich.table import Table

from clients.sdk.terminal.safe_output import overwrite_line
from clients.sdk.terminal.terminal import EXIT_FAILED, command_output, console, home_folder, print_json
from network.bench.conditions import Result
from network.bench.processes import run_to_end
from network.cli.measure.clips_option import with_clips
from network.cli.measure.cluster_option import with_cluster

LOCAL_MONGO_URI = "mongodb://127.0.0.1:27017"
HELD_MAX_COUNT = 1_000_000
GROWTH_AXES = ("clips", "state", "chain", "members", "visits")
_TELL_PERSON_EVERY_S, _TELL_FILE_EVERY_S = 0.2, 15.0


@click.group()
def bench() -> None:
    """Measure the network; exits 0 only if nothing failed.

    Example: blockrobot bench tx --clients 16 --seconds 10 --json
    """


@bench.command()
@click.option("--clients", default=16, show_default=True, type=click.IntRange(1, 256), help="Robots at once.")
@click.option("--seconds", default=10.0, show_default=True, type=click.FloatRange(0.5, 240.0), help="How long.")
@click.option("--nodes", default=4, show_default=True, type=click.IntRange(1, 21), help="Node processes.")
@click.option("--batch", default=16, show_default=True, type=click.IntRange(1, 256), help="Calls a request.")
@command_output
def tx(clients: int, seconds: float, nodes: int, batch: int, as_json: bool) -> None:
    """Measure calls a second, and how long each takes, with many robots at once.

    Example: blockrobot bench tx --clients 8 --batch 32
    """
    from network.bench.throughput import LoadOptions, run_tx_benchmark  # noqa: PLC0415 - a node's code, only when it is needed

    options = LoadOptions(clients=clients, seconds=seconds, nodes=nodes, batch=batch)
    _finish(run_to_end(run_tx_benchmark(options)), as_json=as_json)


@bench.command()
@click.option("--count", default=100, show_default=True, type=click.IntRange(1, 5_000), help="How many calls.")
@click.option("--nodes", default=4, show_default=True, type=click.IntRange(1, 21), help="Node processes.")
@command_output
def latency(count: int, nodes: int, as_json: bool) -> None:
    """Measure how long one call takes on an idle network, with the proof checked.

    Example: blockrobot bench latency --count 200 --json
    """
    from network.bench.latency import run_latency_benchmark  # noqa: PLC0415 - a node's code, only when it is needed

    _finish(run_to_end(run_latency_benchmark(count=count, nodes=nodes)), as_json=as_json)


class _Numbers(click.ParamType[tuple[float, ...]]):
    """Numbers from 0 to a limit, with commas."""

    name = "NUMBERS"

    def __init__(self, most: float) -> None:
        self._most = most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            numbers = (-1.0,)
        if not all(0 <= number <= self._most for number in numbers):
            self.fail(f"{value!r} is no list of numbers from 0 to {self._most:g}, as in 20,80.", param, ctx)
        return numbers


@bench.command()
@click.option("--delay", "delays_ms", type=_Numbers(1_000), default="20,80,200", show_default=True, help="One way, ms.")
@click.option("--loss", "losses_percent", type=_Numbers(20), default="0,0.1", show_default=True, help="Of frames, %.")
@click.option("--nodes", default=4, show_default=True, type=click.IntRange(4, 21), help="Node processes.")
@click.option("--count", default=40, show_default=True, type=click.IntRange(1, 1_000), help="Calls at each.")
@command_output
def wan(delays_ms: tuple[float, ...], losses_percent: tuple[float, ...], nodes: int, count: int, as_json: bool) -> None:
    """Measure what distance between the nodes' hosts costs: one call, and the loss of the leader's host.

    The links of a local network are slowed down and made lossy. Exits 1 if a call fails, or takes longer (p50, without
    loss) than 4.5 one-way delays and 15 ms.

    Example: blockrobot bench wan --delay 20,80 --loss 0 --json
    """
    from network.bench.distance import run_wan_benchmark  # noqa: PLC0415 - a node's code, only when it is needed

    work = run_wan_benchmark(
        delays_ms=delays_ms, losses_percent=losses_percent, nodes=nodes, count=count, tell=_tell_line
    )
    _finish(run_to_end(work), as_json=as_json)


@bench.command()
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1, 100), help="How often each fault.")
@click.option("--nodes", default=4, show_default=True, type=click.IntRange(4, 21), help="Node processes.")
@command_output
def faults(repeats: int, nodes: int, as_json: bool) -> None:
    """Measure how long nothing becomes final when the leader is killed, and how soon it is back.

    Example: blockrobot bench faults --repeats 5 --json
    """
    from network.bench.fault_recovery import run_faults_benchmark  # noqa: PLC0415 - a node's code, only when it is needed

    _finish(run_to_end(run_faults_benchmark(repeats=repeats, nodes=nodes)), as_json=as_json)


@bench.command()
@click.option(
    "--seconds",
    default=3.0,
    show_default=True,
    type=click.FloatRange(0.1, 120.0),
    help="CPU time to spend, for each figure.",
)
@click.option("--profile", is_flag=True, help="Also show where the time of one call goes.")
@click.option("--worst", is_flag=True, help="Instead: what a million gas is in time, program by program (minutes).")
@click.option(
    "--search",
    "search_min",
    type=click.FloatRange(0.05, 600.0),
    help="With --worst: breed dearer programs for so many minutes of CPU time.",
)
@click.option("--seed", type=int, default=1, show_default=True, help="Of the search.")
@command_output
def vm(seconds: float, profile: bool, worst: bool, search_min: float | None, seed: int, as_json: bool) -> None:
    """Measure the contract machine alone: no network, no signatures, no disk.

    \b
    Example: blockrobot bench vm --seconds 1 --profile
    Example: blockrobot bench vm --worst --json
    Example: blockrobot bench vm --worst --search 30 --seed 7 --json
    """
    if search_min is not None and not worst:
        raise click.UsageError("--search needs --worst.")
    if worst:
        from network.bench.vm.vm_worst import run_worst_benchmark, run_worst_search  # noqa: PLC0415 - when it is needed

        if search_min is None:
            _finish(run_worst_benchmark(), as_json=as_json)
        else:
            _finish(run_worst_search(search_min, seed, lambda line: click.echo(line, err=True)), as_json=as_json)
        return
    from network.bench.vm.vm_bench import run_vm_benchmark  # noqa: PLC0415 - a node's code, only when it is needed

    _finish(run_vm_benchmark(seconds, profile=profile), as_json=as_json)


@bench.command("sync")
@click.option(
    "--seconds", default=20.0, show_default=True, type=click.FloatRange(2.0, 900.0), help="How long it is down."
)
@click.option("--rate", default=100, show_default=True, type=click.IntRange(1, 1_000), help="Calls a second meanwhile.")
@click.option("--nodes", default=4, show_default=True, type=click.IntRange(4, 21), help="Node processes.")
@click.option("--new", is_flag=True, help="The node comes back with an empty ledger, and begins at genesis.")
@command_output
def sync_command(seconds: float, rate: int, nodes: int, new: bool, as_json: bool) -> None:
    """Measure how fast a node that was down catches up while the chain goes on.

    Example: blockrobot bench sync --seconds 30 --json
    """
    from network.bench.catch_up import SyncOptions, run_sync_benchmark  # noqa: PLC0415 - only when it is needed

    options = SyncOptions(seconds=seconds, rate=rate, nodes=nodes, new=new)
    _finish(run_to_end(run_sync_benchmark(options)), as_json=as_json)


def _read_counts(_context: click.Context, _option: click.Parameter, text: str | None) -> tuple[int, ...]:
    counts = tuple(int(part) if part.isascii() and part.isdigit() else 0 for part in (text or "").split(",") if text)
    if not all(0 < count <= HELD_MAX_COUNT for count in counts):
        raise click.BadParameter(f"Write numbers from 1 to {HELD_MAX_COUNT:,}, such as 250,4000.")
    return counts


@bench.command("custody")
@click.option(
    "--store", default="sqlite", show_default=True, help="sqlite, mongodb (a server here), or mongodb://host:port."
)
@click.option("--erasures", default=50, show_default=True, type=click.IntRange(1, 10_000), help="One after another.")
@click.option(
    "--behind", default=10_000, show_default=True, type=click.IntRange(50, 1_000_000), help="Records to catch up."
)
@click.option("--held", callback=_read_counts, help="Only erasing, beside so many kept clips: 4000,1000000. SQLite.")
@click.option("--beside", default="", metavar="STORE", help="Then the same with this store, and how many times slower.")
@command_output
@with_clips
def custody_command(
    store: str, erasures: int, behind: int, held: tuple[int, ...], beside: str, apart: Any, as_json: bool
) -> None:
    """Measure what custody costs: erasing until every receipt is final, following, catching up, scanning, room.

    A server for --store or --clips has to run already; databases and objects of the benchmark are removed at its end. A
    line of progress goes to standard error. 10,000 records take a few minutes and about 3 GB of disk; a million of --held
    take 4 GB. With --beside, --clips counts for the second alone. Exits 1 if that takes more than three times as long for
    anything.

    \b
    Example: blockrobot bench custody --store sqlite --json
    Example: blockrobot bench custody --beside mongodb --erasures 8 --behind 400
    Example: blockrobot bench custody --beside sqlite --clips s3://ward/bench --clips-endpoint http://127.0.0.1:8333
    Example: blockrobot bench custody --held 4000,1000000 --json
    """
    from network.bench.custody.custody_bench import CustodyOptions, run_custody_benchmark  # noqa: PLC0415 - only when it is needed

    uri, other = (LOCAL_MONGO_URI if name == "mongodb" else name for name in (store, beside))
    if held and (uri != "sqlite" or beside or apart is not None):
        raise click.UsageError("--held measures the embedded store; leave --store, --beside and --clips out.")
    options = CustodyOptions(store=uri, erasures=erasures, behind=behind, held=held, beside=other, apart=apart)
    _finish(run_to_end(run_custody_benchmark(options, _Teller())), as_json=as_json)


@bench.command("growth")
@click.option("--full", "is_full", is_flag=True, help="Up to the largest sizes too: hours, and some 20 GB of disk.")
@click.option("--axis", "axes", multiple=True, type=click.Choice(GROWTH_AXES), help="Only this; may be repeated.")
@command_output
def growth_command(is_full: bool, axes: tuple[str, ...], as_json: bool) -> None:
    """Measure how each operation's cost grows with what is merely kept: clips, state, chain, members, visits.

    Each size is filled once and kept in the folder `growth` of blockrobot's data, where it may be deleted. Exits 1 if a
    cost grows faster than its goal. A line of progress goes to standard error.

    \b
    Example: blockrobot bench growth --json
    Example: blockrobot bench growth --axis clips --full
    """
    from network.bench.growth.growth_bench import GrowthOptions, choose_sizes, run_growth_benchmark  # noqa: PLC0415 - only when it is needed

    options = GrowthOptions(home_folder() / "growth", choose_sizes(axes, is_full=is_full))
    result = run_to_end(run_growth_benchmark(options, _Teller()))
    if not as_json:
        console.print(_growth_table(result.figures))
        sys.exit(0 if result.ok else EXIT_FAILED)
    _finish(result, as_json=True)


def _growth_table(figures: Any) -> Table:
    """One line for each operation: CPU milliseconds at each size, and the exponent."""
    table = Table(title="growth, CPU ms", title_justify="left")
    for column in ("operation", "kept", "at each size", "exponent", "goal"):
        table.add_column(column)
    for each in figures.operations:
        costs = ", ".join(f"{size.size:.0e}: {size.cpu_ms:.3g}" for size in each.sizes)
        goal = f"{each.goal}" if each.is_within_goal else f"[red]{each.goal}: MISSED[/red]"
        table.add_row(each.operation, each.axis, costs, str(each.exponent), goal)
    return table


@bench.command("flood")
@click.option("--kind", default="all", show_default=True, help="What is sent (--list), several with commas, or all.")
@click.option(
    "--as",
    "identity",
    default="stranger",
    show_default=True,
    type=click.Choice(["stranger", "member", "robot", "node"]),
    help="Whose keys the attacker has; a node's: of one that is known and does not run.",
)
@click.option("--seconds", default=6.0, show_default=True, type=click.FloatRange(1.0, 120.0), help="How long each.")
@click.option("--list", "lists", is_flag=True, help="Only show what there is to send.")
@command_output
def flood_command(kind: str, identity: Any, seconds: float, lists: bool, as_json: bool) -> None:
    """Flood a network of four nodes, from one core and with at most 20 MB a second, and measure what it does to others.

    Exits 1 if a goal is missed: finality at most five times as late (p95), `/status` within a second, the attacker named
    in logs and by the doctor (unless nothing was refused or late), and all as before 2 s after the end. A line for each
    kind goes to standard error.

    Example: blockrobot bench flood --kind TRANSACTIONS --as node --json
    """
    from network.bench.flood.flood_bench import FloodOptions, run_flood_benchmark  # noqa: PLC0415 - only when it is needed
    from network.bench.flood.flood_routes import kinds_of  # noqa: PLC0415

    if lists:
        click.echo("\n".join(kinds_of(identity)))
        return
    _finish(run_to_end(run_flood_benchmark(FloodOptions(kind, identity, seconds), _tell_line)), as_json=as_json)


@bench.command("proxy")
@click.option("--members", default=50, show_default=True, type=click.IntRange(1, 250), help="Who submit at once.")
@click.option(
    "--count", default=2_000, show_default=True, type=click.IntRange(1, 40_000), help="Calls of all together."
)
@click.option("--seconds", default=10.0, show_default=True, type=click.FloatRange(1.0, 240.0), help="In how long.")
@click.option("--nodes", default=4, show_default=True, type=click.IntRange(1, 21), help="Node processes.")
@click.option(
    "--apart",
    default="address",
    show_default=True,
    type=click.Choice(["address", "session"]),
    help="What tells members apart: an address each, or, behind one address, a session each.",
)
@command_output
def proxy_command(members: int, count: int, seconds: float, nodes: int, apart: Any, as_json: bool) -> None:
    """Measure whether members behind one proxy are refused because of each other. Runs nginx before one node.

    Exits 1 if anybody was refused by a budget that is not their own, or not answered.

    Example: blockrobot bench proxy --members 50 --count 2000 --json
    """
    from network.bench.proxy_load import ProxyOptions, run_proxy_benchmark  # noqa: PLC0415 - only when it is needed

    options = ProxyOptions(members=members, count=count, seconds=seconds, nodes=nodes, apart=apart)
    _finish(run_to_end(run_proxy_benchmark(options)), as_json=as_json)


@bench.command("hiding")
@click.option("--scenes", default=200, show_default=True, type=click.IntRange(1, 10_000), help="Scenes to judge.")
@click.option("--seeds", default=5, show_default=True, type=click.IntRange(1, 100), help="Over how many seeds.")
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0, 2**31), help="The first seed.")
@click.option(
    "--learning-scenes",
    default=None,
    show_default="40, with --moving none",
    type=click.IntRange(4, 1_000),
    help="To train on, for each seed; with --moving, attackers of blank pictures learn from so many drives.",
)
@click.option("--people", default=8, show_default=True, type=click.IntRange(2, 64), help="To tell apart by their gait.")
@click.option(
    "--matcher-tracks", default=0, type=click.IntRange(0, 1_000_000), help="Also judge the matcher on drawn tracks."
)
@click.option(
    "--companion-scenes", default=0, type=click.IntRange(0, 10_000), help="Also judge companions, scenes of each kind."
)
@click.option("--processes", default=0, type=click.IntRange(0, 256), help="Processes (0: one for each core).")
@with_cluster("processes")
@click.option(
    "--antennas",
    default="0",
    show_default=True,
    type=click.Choice(["0", "1", "2", "4"]),
    help="A reader with so many, which look to different sides (0: it tells front and back).",
)
@click.option(
    "--moving",
    is_flag=True,
    help="Judge a robot that drives: the other options count but --seeds, --matcher-tracks, --companion-scenes.",
)
@command_output
def hiding(as_json: bool, moving: bool, antennas: str, on: str, learning_scenes: int | None, **options: int) -> None:
    """Judge hiding: what hand-made and learned attackers recover of the people whom a robot hides.

    Exits 1 if a goal is missed. Needs the extra `attack` (scikit-learn). A line of progress goes to standard error.

    \b
    Example: blockrobot bench hiding --scenes 200 --json
    Example: blockrobot bench hiding --moving --scenes 60 --learning-scenes 40 --json
    """
    if moving:
        from network.lab.hiding.moving.evaluate_drives import run_drive_benchmark  # noqa: PLC0415 - only when needed

        chosen = {name: options[name] for name in ("scenes", "seed", "people", "processes")}
        chosen["learning_scenes"] = learning_scenes or 0
        _finish(run_drive_benchmark(**chosen, antennas=int(antennas), on=on, progress=_Teller()), as_json=as_json)
        return
    from network.lab.hiding.evaluate import HidingOptions, run_hiding_benchmark  # noqa: PLC0415 - only when it is needed

    if learning_scenes is not None:
        options["learning_scenes"] = learning_scenes
    _finish(run_hiding_benchmark(HidingOptions(**options, antennas=int(antennas), on=on), _Teller()), as_json=as_json)


@bench.command("matcher")
@click.option(
    "--tracks", default=2_000, show_default=True, type=click.IntRange(1, 1_000_000), help="Drawn tracks, each group."
)
@click.option("--seed", default=1, show_default=True, type=click.IntRange(min=0), help="What is drawn.")
@click.option("--workers", default=None, type=click.IntRange(1, 64), help="Processes at once (all cores).")
@with_cluster("workers")
@click.option("--moving", is_flag=True, help="Of a robot that drives; also if it counted every reading.")
@command_output
def matcher_command(tracks: int, seed: int, workers: int | None, on: str, moving: bool, as_json: bool) -> None:
    """Measure how often the robot would take a tag's bearer for somebody else, and how much it withholds.

    Exits 1 if a goal is missed. 10,000 tracks take a few minutes on two cores.

    \b
    Example: blockrobot bench matcher --tracks 10000 --seed 1 --json
    Example: blockrobot bench matcher --moving --tracks 2000 --json
    """
    from network.lab.matcher.matcher_evaluation import judge_matcher  # noqa: PLC0415 - only when it is needed
    from network.lab.matcher.moving_evaluation import judge_moving_matcher  # noqa: PLC0415 - only when it is needed

    def on_progress(done: int, of: int) -> None:
        if sys.stderr.isatty():
            overwrite_line(f"drawn and judged: {done} of {of} hundreds", ends=done == of)

    judged = judge_moving_matcher if moving else judge_matcher
    _finish(judged(tracks, seed, workers=workers, on=on, progress=on_progress), as_json=as_json)


def _tell_line(line: str) -> None:
    click.echo(line, err=True)


class _Teller:
    """Progress on standard error: a moving line on terminals, else occasional lines."""

    def __init__(self) -> None:
        self._last = 0.0

    def __call__(self, line: str) -> None:
        moving = sys.stderr.isatty()
        if time.monotonic() - self._last < (_TELL_PERSON_EVERY_S if moving else _TELL_FILE_EVERY_S):
            return
        self._last = time.monotonic()
        if moving:
            overwrite_line(line)
        else:
            click.echo(line, err=True)


@bench.command("companions")
@click.option("--scenes", default=12, show_default=True, type=click.IntRange(1, 10_000), help="Scenes of each kind.")
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0, 2**20), help="What is drawn.")
@click.option("--workers", default=None, type=click.IntRange(1, 64), help="Processes at once (all cores).")
@with_cluster("workers")
@command_output
def companions_command(scenes: int, seed: int, workers: int | None, on: str, as_json: bool) -> None:
    """Measure how often two people in one silhouette are found, and single people taken for two.

    Exits 1 if a goal is missed.

    Example: blockrobot bench companions --scenes 40 --seed 2 --json
    """
    from network.lab.hiding.companions import judge_companions  # noqa: PLC0415 - only when it is needed

    _finish(judge_companions(seed, scenes=scenes, workers=workers, on=on), as_json=as_json)


@bench.command("pedestrians")
@click.option("--tags", default=12, show_default=True, type=click.IntRange(1, 64), help="Drawn tags.")
@click.option(
    "--seed", default=1, show_default=True, type=click.IntRange(0, 2**31), help="What the readings are drawn from."
)
@click.option(
    "--film", default=None, type=click.Path(path_type=Path), help="The film. [default: opencv-doc's vtest.avi]"
)
@click.option("--picture", default=None, type=click.Path(path_type=Path), help="Write what is shown to whom, as a PNG.")
@command_output
def pedestrians_command(tags: int, seed: int, film: Path | None, picture: Path | None, as_json: bool) -> None:
    """Measure how many real pedestrians stay visible to whom, on a film of them.

    The film is vtest.avi of Debian's opencv-doc: colour without depth, from a high camera. Depth is worked out from flat
    ground, tags are drawn for those who are followed longest. Exits 1 if anybody is visible to somebody else.

    Example: blockrobot bench pedestrians --picture shown.png
    """
    from network.lab.pedestrians.evaluate import judge_pedestrians  # noqa: PLC0415
    from network.lab.pedestrians.film import FILM  # noqa: PLC0415 - only when it is needed

    result = judge_pedestrians(seed, tags=tags, film_file=film or FILM, picture=picture, on_progress=_Teller())
    _finish(result, as_json=as_json)


@bench.command("robot")
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(2.0, 3_600.0), help="How long.")
@click.option("--robots", default=1, show_default=True, type=click.IntRange(1, 16), help="Robots at once.")
@click.option("--fps", default=30, show_default=True, type=click.IntRange(1, 60), help="Frames a second, each robot.")
@click.option("--cut", default=0.0, type=click.FloatRange(0.0, 600.0), help="Seconds without a network, in the middle.")
@click.option(
    "--seed", default=1, show_default=True, type=click.IntRange(0, 2**31), help="What the scene is drawn from."
)
@click.option(
    "--drives", is_flag=True, help="The robot drives to and fro, with odometry, and both people walk with it."
)
@command_output
@with_clips
def robot_command(
    seconds: float, robots: int, fps: int, cut: float, seed: int, drives: bool, apart: Any, as_json: bool
) -> None:
    """Measure whether a robot keeps up with its camera, two registered people in view; no frame may be lost or doubled.

    A stretch of at most 20 s is rendered once, kept, and looped; then robots, nodes and wallets run for real. At the
    end each person's wallet opens every picture of theirs. A line of progress goes to standard error. With --drives people
    are hidden without the empty scene on the way, and --seconds is at least a round of 20.

    \b
    Example: blockrobot bench robot --seconds 60 --robots 1 --json
    Example: blockrobot bench robot --seconds 180 --cut 60
    """
    from network.bench.robot.robot_bench import RobotOptions, run_robot_benchmark  # noqa: PLC0415 - only when it is needed
    from network.bench.robot.robot_scene import LOOP_MAX_S  # noqa: PLC0415

    if cut >= seconds:
        raise click.UsageError("--cut is a part of --seconds, and must be shorter.")
    if drives and seconds < LOOP_MAX_S:
        raise click.UsageError(f"With --drives, --seconds is at least a round of {LOOP_MAX_S}.")
    options = RobotOptions(
        seconds=seconds,
        robots=robots,
        fps=fps,
        cut_s=cut,
        seed=seed,
        cache=home_folder() / "recordings",
        apart=apart,
        drives=drives,
    )
    _finish(run_to_end(run_robot_benchmark(options, _Teller())), as_json=as_json)


def _finish(result: Result[Any], *, as_json: bool) -> None:
    told = msgspec.to_builtins(result)
    if as_json:
        print_json(told)
    else:
        console.print(_table(told))
    if not result.ok:
        sys.exit(EXIT_FAILED)


def _table(told: Mapping[str, Any]) -> Table:
    table = Table(title=f"{told['name']}: {'ok' if told['ok'] else 'FAILED'}", title_justify="left")
    table.add_column("figure")
    table.add_column("value", justify="right")
    for name, value in told["figures"].items():
        groups = value if isinstance(value, dict) and all(isinstance(part, dict) for part in value.values()) else {}
        for group, part in groups.items():
            table.add_row(f"{name}: {group}", ", ".join(f"{key} {figure}" for key, figure in part.items()))
        if not groups:
            table.add_row(name, str(value))
    table.add_section()
    for name, value in told["conditions"].items():
        table.add_row(name, str(value))
    if "programs" in told:
        table.add_section()
        for program in told["programs"]:
            table.add_row(f"ms a million gas: {program['name']}", str(program["ms_per_million_gas"]))
    if "profile" in told:
        table.add_section()
        for name, value in told["profile"].items():
            table.add_row(f"us a call in {name}", str(value))
    return table
