"""`blockrobot fault ...`: breaks a local network on purpose."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import click
import msgspec
from rich.table import Table

from clients.sdk.new_files import read_given_file
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXISTING_FILE, EXIT_FAILED, command_output, console, print_answer
from consensus.bounded_text import TOML_MAX_BYTES
from consensus.errors import BlockRobotError
from network.byzantine import BEHAVIOURS
from network.cli.cluster.cluster_answers import (
    FaultAnswer,
    FaultError,
    FaultListAnswer,
    FaultRunAnswer,
    FaultStep,
    FaultyNode,
    SwitchedFaults,
)
from network.cli.cluster.cluster_options import folder_option, network_folder
from network.cluster import Cluster
from network.faults.actions import (
    LINK_PROFILES,
    Action,
    Heal,
    Kill,
    Pause,
    Restart,
    Resume,
    check_seed,
    make_link_fault,
)
from network.faults.control import FaultControl
from network.faults.plan import FaultPlan, parse_plan
from network.faults.requested import StepDone, carry_out_requested, open_control, run_plan
from node.faults import DISKS

_PROFILES = "; ".join(f"{name}: {profile.meaning}" for name, profile in LINK_PROFILES.items())


def _control(folder: Path | None, seed: int = 0) -> FaultControl:
    return open_control(Cluster(network_folder(folder)), seed)


def _do(control: FaultControl, action: Action, *, as_json: bool) -> None:
    started = asyncio.run(carry_out_requested(control, action))
    if as_json:
        print_answer(FaultAnswer(done=action.describe()))
        return
    console.print(f"Done: {escape(action.describe())}.")
    if started and isinstance(action, Heal):
        console.print(f"Restarted, for only so does a liar become honest: {escape(', '.join(started))}.")


@click.group()
def fault() -> None:
    """Break the local network on purpose, and mend it; `blockrobot status --watch` shows what happens.

    Example: blockrobot fault partition "node-1,node-2 | node-3,node-4"
    """


_OF_ONE_NODE: dict[type[Kill | Restart | Pause | Resume], str] = {
    Kill: "Kill a node as a power cut would: no last word, nothing flushed.\n\nExample: blockrobot fault kill node-2",
    Restart: "Start a node again, as an honest one; one that runs is stopped cleanly first. Its other faults stay on."
    "\n\nExample: blockrobot fault restart node-2",
    Pause: "Stop a node's clockwork: its connections stay open, and it says nothing."
    "\n\nExample: blockrobot fault pause node-3",
    Resume: "Let a paused node go on.\n\nExample: blockrobot fault resume node-3",
}


def _add_of_one_node(make: type[Kill | Restart | Pause | Resume], text: str) -> None:
    @fault.command(make.__name__.lower(), help=text)
    @click.argument("node")
    @folder_option
    @command_output
    def command(node: str, folder: Path | None, as_json: bool) -> None:
        # A network of which no node runs may be started so.
        control = FaultControl(Cluster(network_folder(folder))) if make is Restart else _control(folder)
        _do(control, make(control.reader.node(node)), as_json=as_json)


for _make, _text in _OF_ONE_NODE.items():
    _add_of_one_node(_make, _text)


@fault.command()
@click.argument("groups")
@folder_option
@command_output
def partition(groups: str, folder: Path | None, as_json: bool) -> None:
    """Cut the network into groups that hear nothing of each other; nodes not named make one more group.

    Examples: blockrobot fault partition "node-1,node-2 | node-3,node-4"; blockrobot fault partition node-4
    """
    control = _control(folder)
    _do(control, control.reader.partition(groups), as_json=as_json)


@fault.command()
@click.argument("nodes", nargs=-1)
@folder_option
@command_output
def heal(nodes: tuple[str, ...], folder: Path | None, as_json: bool) -> None:
    """End the faults of these nodes, or of all: links, clocks, disks, pauses, lies. Who was killed stays down.

    Examples: blockrobot fault heal; blockrobot fault heal node-2
    """
    control = _control(folder)
    _do(control, Heal(tuple(control.reader.node(name) for name in nodes)), as_json=as_json)


@fault.command(epilog=f"Profiles, for one direction: {_PROFILES}.")
@click.argument("link", nargs=-1, required=True, metavar="A B | 'A<->B'")
@click.option("--profile", type=click.Choice(list(LINK_PROFILES)), help="A kind of link; figures replace its own.")
@click.option("--delay", "delay_ms", type=float, help="Milliseconds that every frame waits.")
@click.option("--jitter", "jitter_ms", type=float, help="Up to so many milliseconds more, by chance.")
@click.option("--loss", type=float, help="The share of frames that vanish, such as 0.05.")
@click.option("--bandwidth", "bandwidth_kbytes_per_s", type=float, help="Kilobytes a second; 0 is no limit.")
@click.option("--cut", is_flag=True, help="Let nothing through.")
@click.option("--seed", default=0, show_default=True, help="What the link's chance is drawn from.")
@folder_option
@command_output
def link(link: tuple[str, ...], folder: Path | None, as_json: bool, seed: int, **figures: Any) -> None:
    """Make the link from A to B (one direction) or A<->B (both) slow or lossy; without figures, sound again.

    Examples: blockrobot fault link node-1 node-3 --delay 200; blockrobot fault link 'node-1<->node-2' --profile wan
    """
    fault = make_link_fault(**figures)
    control = _control(folder, check_seed(seed))
    text = f"{link[0]} -> {link[1]}" if len(link) == 2 else " ".join(link)
    _do(control, control.reader.link(text, fault), as_json=as_json)


@fault.command(context_settings={"ignore_unknown_options": True, "help_option_names": ["--help"]})
@click.argument("node")
@click.argument("offset")
@folder_option
@command_output
def skew(node: str, offset: str, folder: Path | None, as_json: bool) -> None:
    """Set a node's clock wrong by an offset such as +1h or -90s; 0 sets it right, running or not. A change is a jump.

    Examples: blockrobot fault skew node-2 +1h; blockrobot fault skew node-2 -90s; blockrobot fault skew node-2 0
    """
    control = _control(folder)
    _do(control, control.reader.skew(node, offset), as_json=as_json)


@fault.command()
@click.argument("node")
@click.argument("state", type=click.Choice(["full", "free"]))
@click.option("--of", "disk", type=click.Choice(DISKS), default="journal", show_default=True, help="Whose disk.")
@folder_option
@command_output
def disk(node: str, state: str, disk: str, folder: Path | None, as_json: bool) -> None:
    """Let the disk under a node's journal, ledger or custody store be full, or free again (running or not).

    Examples: blockrobot fault disk node-2 full; blockrobot fault disk node-2 free --of ledger
    """
    control = _control(folder)
    _do(control, control.reader.disk(node, disk, is_full=state == "full"), as_json=as_json)


@fault.command(epilog=f"Behaviours: {', '.join(BEHAVIOURS)}. Several are joined with +.")
@click.argument("node")
@click.argument("behaviour")
@click.option("--seed", default=0, show_default=True, help="What the lies are drawn from.")
@folder_option
@command_output
def byzantine(node: str, behaviour: str, seed: int, folder: Path | None, as_json: bool) -> None:
    """Restart a node as one that lies with its genuine key; `fault restart` makes it honest again.

    Examples: blockrobot fault byzantine node-4 equivocate; blockrobot fault byzantine node-4 double-vote+garbage
    """
    control = _control(folder)
    _do(control, control.reader.byzantine(node, behaviour, seed), as_json=as_json)


def _switched_faults(name: str, switched: Any) -> SwitchedFaults | None:
    try:
        return None if switched is None else msgspec.convert(switched, SwitchedFaults)
    except msgspec.ValidationError:
        raise BlockRobotError("INTERNAL", f"{name} tells of its faults in another form; compare versions.") from None


@fault.command(name="list")
@folder_option
@command_output
def list_faults(folder: Path | None, as_json: bool) -> None:
    """Show what is wrong on purpose, node by node.

    Example: blockrobot fault list --json
    """
    rows = asyncio.run(FaultControl(Cluster(network_folder(folder))).state())
    if as_json:
        nodes = [
            FaultyNode(
                name=row.name,
                running=row.running,
                paused=row.paused,
                behaviour=row.behaviour,
                switched=_switched_faults(row.name, row.switched),
                faults=row.describe(),
            )
            for row in rows
        ]
        print_answer(FaultListAnswer(nodes=nodes))
        return
    table = Table(title="Faults that are on", title_justify="left")
    for column in ("node", "faults"):
        table.add_column(column)
    for row in rows:
        table.add_row(row.name, escape("; ".join(row.describe())) or "-")
    console.print(table)


@fault.command()
@click.argument("plan", type=EXISTING_FILE)
@click.option("--dry-run", is_flag=True, help="Show the steps, random ones included, and do nothing.")
@folder_option
@command_output
def run(plan: Path, dry_run: bool, folder: Path | None, as_json: bool) -> None:
    """Carry out a plan of timed and random faults (TOML); one wrong line, and nothing of it is done.

    Example: blockrobot fault run plan.toml --dry-run
    """
    try:
        text = read_given_file(plan, TOML_MAX_BYTES).decode("utf-8")
    except UnicodeDecodeError:
        raise BlockRobotError("FAULT_PLAN_INVALID", f"{plan} is no text.") from None
    if dry_run:
        _show_plan(parse_plan(text, Cluster(network_folder(folder)).names), as_json=as_json)
        return
    control = _control(folder)
    read = parse_plan(text, control.cluster.names)

    def on_progress(done: StepDone) -> None:
        if not as_json:
            problem = "" if done.error is None else f"  [red]{done.error.code}[/red]: {escape(done.error.detail)}"
            console.print(f"{done.at_ms / 1000:8.2f} s  {escape(done.step.action.describe())}{problem}")

    control = FaultControl(control.cluster, read.seed)
    results = asyncio.run(run_plan(read, control, on_progress))
    is_stopped = _is_stopped(control.cluster, results)
    is_ok = all(done.error is None for done in results) and not is_stopped
    if as_json:
        steps = [
            FaultStep(
                at_ms=done.at_ms,
                line=done.step.line,
                do=done.step.action.describe(),
                error=None if done.error is None else FaultError(code=done.error.code, detail=done.error.detail),
            )
            for done in results
        ]
        print_answer(FaultRunAnswer(seed=read.seed, steps=steps), ok=is_ok)
    elif is_stopped:
        raise BlockRobotError("FAULT_TARGET_ABSENT", "No node is running: the network was stopped meanwhile.")
    if not is_ok:
        sys.exit(EXIT_FAILED)


def _is_stopped(cluster: Cluster, results: list[StepDone]) -> bool:
    was_killed = bool(results) and isinstance(results[-1].step.action, Kill)
    return not was_killed and not any(cluster.is_running(name) for name in cluster.names)


def _show_plan(plan: FaultPlan, *, as_json: bool) -> None:
    if as_json:
        steps = [FaultStep(at_ms=step.at_ms, line=step.line, do=step.action.describe()) for step in plan.steps]
        print_answer(FaultRunAnswer(seed=plan.seed, steps=steps))
        return
    console.print(f"Seed {plan.seed}, {len(plan.steps)} steps; nothing is done.")
    for step in plan.steps:
        console.print(f"{step.at_ms / 1000:8.2f} s  {escape(step.action.describe())}  (line {step.line})")
