"""`blockrobot up | down | status | logs`: a local cluster."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec
from rich.table import Table
from rich.text import Text

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXISTING_FILE, command_output, console, load_genesis, print_answer
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_answers import DownAnswer, LogLine, LogsAnswer
from network.cli.cluster.cluster_options import dir_words, folder_option, network_folder
from network.cli.cluster.remote_table import ask_elsewhere, ask_from_outside, print_elsewhere
from network.cli.cluster.status_answers import NodeStatus, StatusAnswer
from network.cluster import Cluster, NodeStatusReport
from network.cluster_monitor import accusers_of, clock_words, kept_lines, refusals_of, removal_of
from network.doctor.findings import Finding
from network.notices.notice_publishing import publish_demo_notice
from network.provisioning.network_files import require_own
from network.provisioning.network_layout import FIRST_PORT, create_network
from network.provisioning.network_removal import remove_network
from network.remote_nodes import RemoteNode

ORGANISATIONS_COUNT = 2
TOLD_NODES_COUNT = 2
TOLD_LINES_COUNT = 5
TOLD_LINE_CHARS = 400
_TEXT_COLUMNS = frozenset({"node", "state", "leads"})


@click.command()
@folder_option
@click.option(
    "--nodes", default=4, show_default=True, type=click.IntRange(1, 21), help="How many nodes a new network has."
)
@click.option("--base-port", default=FIRST_PORT, show_default=True, help="The first of ten ports a node.")
@click.option(
    "--store", default="sqlite", show_default=True, help="Where custodians keep data: sqlite or mongodb://..."
)
@click.option("--archive", multiple=True, metavar="NODE", help="A node that keeps every block; may be repeated.")
@click.option("--ephemeral", is_flag=True, help="Begin with an empty network, forgetting the last one.")
@click.option("--console", "with_console", is_flag=True, help="Then show it in the browser: see blockrobot console.")
@click.option("--no-browser", is_flag=True, help="With --console: open no browser; say which file opens the page.")
@command_output
def up(
    folder: Path | None,
    nodes: int,
    base_port: int,
    store: str,
    archive: tuple[str, ...],
    ephemeral: bool,
    with_console: bool,
    no_browser: bool,
    as_json: bool,
) -> None:
    """Start the local network, making it first if there is none. Its state survives down and up.

    Of a network that runs it starts the nodes that are down, and says which.

    A new one publishes the demonstration hospital's privacy notice: blockrobot notice show. Nodes drop blocks that are
    older than any record may be, but for those that --archive names.

    Examples: blockrobot up --nodes 4; blockrobot up --archive node-4
    """
    place = network_folder(folder)
    if ephemeral and (place / "genesis.json").exists():
        require_own(place)
        Cluster(place).stop_all()
        remove_network(place)
    is_new = not (place / "genesis.json").exists()
    if archive and not is_new:
        text = "The network is there already: set `archive` in [storage] of the node's node.toml, and start it again."
        raise BlockRobotError("CONFIGURATION_INVALID", text)
    if is_new:
        # A name of its own keeps this network's databases apart from those of earlier ones on the same server.
        name = f"blockrobot-{secrets.token_hex(4)}"
        create_network(
            place,
            nodes=nodes,
            organisations=min(ORGANISATIONS_COUNT, nodes),
            base_port=base_port,
            store=store,
            network=name,
            faults=True,
            archives=archive,
        )
    cluster = Cluster(place)
    started = cluster.start_all()
    others = [name for name in cluster.names if name not in started]
    try:
        with console.status("Waiting for the nodes to be ready ..."):
            asyncio.run(_wait_for(cluster, started))
    except (BlockRobotError, KeyboardInterrupt) as error:
        if not others:
            cluster.stop_all()
        for name in started if others else ():
            cluster.stop(name)
        if is_new:
            # A network that never ran holds nothing; kept, it would insist on the ports and store that failed.
            failure = _first_failure(cluster, error)
            remove_network(place)
            raise failure from None
        raise
    if is_new:
        _tell_people(place)
    if others:
        click.echo(f"Started: {', '.join(started)}. Already running: {', '.join(others)}.", err=True)
    if not (with_console and as_json):
        report(asyncio.run(cluster.status()), place, as_json=as_json)
    if with_console:
        from network.cli.cluster.console_commands import show_console  # noqa: PLC0415 - only when it is needed

        show_console(cluster, no_browser=no_browser, as_json=as_json)


async def _wait_for(cluster: Cluster, started: list[str]) -> None:
    """Nodes that ran before may be stuck, or too few to be ready: then those that were started only have to answer."""
    if started == cluster.names:
        await cluster.wait_ready()
    else:
        await asyncio.gather(*map(cluster.wait_answering, started))


def _tell_people(place: Path) -> None:
    """Without a notice nobody is asked for consent."""
    try:
        asyncio.run(publish_demo_notice(place))
    except (BlockRobotError, OSError) as error:
        click.echo(f"The demonstration's privacy notice is not published: {error}", err=True)


def _first_failure(cluster: Cluster, error: BaseException) -> BaseException:
    if not isinstance(error, BlockRobotError) or error.code != "CLUSTER_START_FAILED":
        return error
    names = str(error.context.get("nodes", "")).split()[:TOLD_NODES_COUNT]
    lines = [
        f"  {name} {line[:TOLD_LINE_CHARS]}" for name in names for line in cluster.last_lines(name, TOLD_LINES_COUNT)
    ]
    return BlockRobotError("CLUSTER_FIRST_START_FAILED", "\n".join([error.detail, *lines]))


@click.command()
@click.argument("nodes", nargs=-1, metavar="[NODE]...")
@folder_option
@command_output
def down(nodes: tuple[str, ...], folder: Path | None, as_json: bool) -> None:
    """Stop the local network, or only the nodes that are named. Nothing final is lost.

    Examples: blockrobot down; blockrobot down node-5
    """
    stopped = Cluster(network_folder(folder)).stop_all(nodes)
    if as_json:
        print_answer(DownAnswer(stopped=stopped))
    else:
        console.print(f"Stopped: {', '.join(stopped)}." if stopped else "Nothing was running.")


@click.command()
@folder_option
@click.option(
    "--watch", "is_watching", is_flag=True, help="Go on showing what happens; q quits. With --json: JSON lines."
)
@click.option("--seconds", type=click.FloatRange(0, 86_400), help="With --watch: end after so long.")
@click.option("--genesis", "outside", type=EXISTING_FILE, help="Ask the nodes of this genesis file, from outside.")
@command_output
def status(folder: Path | None, is_watching: bool, seconds: float | None, outside: Path | None, as_json: bool) -> None:
    """Show each node's height, finalized height, round, peers and custody checkpoint.

    Nodes of the network that are not in this folder are asked what they tell everybody. A host without a node needs the
    network's genesis file, which each of its organisations hands out.

    Examples: blockrobot status --watch; blockrobot --node https://ward-1.example:7273 status --genesis genesis.json
    """
    place = network_folder(folder)
    if outside is not None:
        if is_watching or folder is not None:
            raise click.UsageError("--genesis asks from outside: without --dir and --watch.")
        report([], outside.parent, ask_from_outside(load_genesis(outside), quiet=as_json), as_json=as_json)
        return
    if is_watching:
        if not Cluster(place).names:
            raise click.UsageError(f"--watch looks into nodes of this machine, and none is in {place}.")
        from network.cli.cluster.status_watch import watch  # noqa: PLC0415 - only when it is needed

        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(watch(Cluster(place), as_json=as_json, seconds=seconds))
        return
    cluster = Cluster(place)
    rows = asyncio.run(cluster.status())
    elsewhere = ask_elsewhere(cluster, quiet=as_json)
    report(rows, place, elsewhere, as_json=as_json)
    if as_json:
        return
    if rows and not any(row.running for row in rows):
        start = f"node run {rows[0].name}{dir_words(place)} --detach" if elsewhere else f"up{dir_words(place)}"
        console.print(f"Nothing runs here. Next: blockrobot {start}", soft_wrap=True)
    elif any(config.faults_enabled for config in cluster.configs.values()):
        _tell_faults(cluster, place)


def _tell_faults(cluster: Cluster, place: Path) -> None:
    from network.faults.control import FaultControl  # noqa: PLC0415 - only when it is needed

    broken = [state.name for state in asyncio.run(FaultControl(cluster).state()) if state.running and state.describe()]
    if broken:
        told = f"Broken on purpose: {', '.join(broken)}. See blockrobot fault list{dir_words(place)}"
        console.print(f"{escape(told)}; to end it: blockrobot fault heal{dir_words(place)}", soft_wrap=True)


@click.command()
@click.argument("node", required=False)
@folder_option
@click.option("--lines", default=20, show_default=True, type=click.IntRange(1, 10_000), help="How many lines of each.")
@command_output
def logs(node: str | None, folder: Path | None, lines: int, as_json: bool) -> None:
    """Show the last log lines of one node, or of all.

    Example: blockrobot logs node-2 --lines 50
    """
    cluster = Cluster(network_folder(folder))
    rows: list[tuple[str, str]] = []
    for name in [node] if node else cluster.names:
        rows.extend((name, line) for line in cluster.last_lines(name, lines))
    if as_json:
        print_answer(LogsAnswer(lines=[LogLine(node=name, line=line) for name, line in rows]))
        return
    for name, line in rows:
        click.echo(f"{name} {line}")


_TONES = {"ready": "green", "waiting": "yellow", "stopped": "yellow", "removed": "yellow"}
"""What a state is shown in; any other is a fault, and red."""


def _state_of(row: NodeStatusReport, accused_by: Sequence[str] = ()) -> str:
    if not row.running:
        return "stopped"
    if row.status is None:
        return "no answer"
    if not row.status.get("ready"):
        return "removed" if removal_of(row.name, row.status) else "waiting"
    if not (row.status.get("lockout") or {}).get("can_end", True):
        return "locked out"
    if row.status.get("finality", {}).get("late"):
        return "stuck"
    suspended = "suspended" if row.status.get("suspended_height") is not None else ""
    lies = "lies" if row.behaviour else ""
    clock = "wrong clock" if row.status.get("finality", {}).get("clock_error_s") else ""
    return suspended or lies or clock or ("accused" if accused_by else "ready")


def _status_answer(row: NodeStatusReport) -> NodeStatus:
    """Return the status, and the fields that a node of another version says in another form."""
    told = {**(row.status or {}), "name": row.name, "running": row.running}
    kinds = {field.name: field.type for field in msgspec.structs.fields(NodeStatus)}
    known: dict[str, Any] = {}
    unread = []
    for name, value in told.items():
        with contextlib.suppress(KeyError, msgspec.ValidationError):
            known[name] = msgspec.convert(value, kinds[name])
        if name not in known or msgspec.to_builtins(known[name]) != value:
            unread.append(name)
    return NodeStatus(**known | ({"unread": unread} if unread else {}))


def report(
    reports: list[NodeStatusReport], folder: Path, elsewhere: Sequence[RemoteNode] = (), *, as_json: bool
) -> None:
    if as_json:
        nodes = [_status_answer(row) for row in reports]
        answer = StatusAnswer(directory=str(folder), nodes=nodes, elsewhere=list(elsewhere))
        is_answered = all(row.status for row in reports) if reports else any(node.problem is None for node in elsewhere)
        print_answer(answer, ok=is_answered)
        return
    if not reports:
        console.print(f"No node of the network is in {escape(str(folder))}.", soft_wrap=True)
        print_elsewhere(elsewhere)
        return
    table = Table(
        title=f"Network in {escape(str(folder))}", title_justify="left", pad_edge=False, collapse_padding=True
    )
    for column in ("node", "state", "height", "final", "round", "leads", "peers", "waiting", "custody"):
        table.add_column(
            column, justify="left" if column in _TEXT_COLUMNS else "right", no_wrap=column in _TEXT_COLUMNS
        )
    statuses = {row.name: row.status for row in reports}
    for row in reports:
        seen = row.status or {}
        state = _state_of(row, accusers_of(row.name, statuses))
        values = [seen.get(key) for key in ("height", "finalized_height", "round", "leader")]
        peers = len(seen["peers"]) if "peers" in seen else None
        custody = seen.get("custody_checkpoint")
        cells = [*values, peers, seen.get("mempool"), custody]
        shown = Text(state, style=_TONES.get(state, "red"))
        table.add_row(row.name, shown, *("-" if cell is None else str(cell) for cell in cells))
    console.print(table)
    told = [row.status for row in reports if row.status is not None and "finality" in row.status]
    if told:
        newest = min(told, key=lambda status: (-status["finalized_height"], status["finality"]["age_s"]))
        age_s = newest["finality"]["age_s"]
        console.print(f"Newest final block: {newest['finalized_height']}, {age_s:.0f} s ago.")
    for line in kept_lines(statuses):
        console.print(escape(line), soft_wrap=True)
    for row in reports:
        lies = _lies(row, accusers_of(row.name, statuses))
        for sentence in _troubles(row.name, row.status or {}) + lies:
            console.print(escape(sentence), soft_wrap=True, style="red" if sentence in lies else "")
    print_elsewhere(elsewhere)


def _lies(row: NodeStatusReport, accused_by: Sequence[str]) -> list[str]:
    told = []
    if row.behaviour:
        told.append(f"{row.name} was told to lie ({row.behaviour}).")
    if accused_by:
        many = "say" if len(accused_by) > 1 else "says"
        names = ", ".join(accused_by)
        told.append(f"{names} {many} that {row.name} contradicted itself; the evidence: blockrobot producer list")
    return told


def _troubles(name: str, status: Mapping[str, Any]) -> list[str]:
    removal = removal_of(name, status)
    if removal:
        return [f"{removal} (NODE_REMOVED) {Finding('NODE_REMOVED', name, '').next_step}"]
    told = []
    problem = status.get("problem")
    if problem:
        told.append(f"{name}: {problem['detail']} ({problem['code']}) {problem['next_step']}")
    if status.get("lockout"):
        told.append(f"{name} signs nothing ({status['lockout']['reason']}) until {status['lockout']['until']}.")
        if not status["lockout"]["can_end"]:
            told.append(Finding("LOCKED_OUT_FOR_GOOD", name, "").next_step)
    finality = status.get("finality", {})
    if finality.get("late"):
        work = f", and transactions wait ({status.get('mempool')})" if status.get("mempool") else ""
        told.append(f"{name} has had no new final block for {finality['age_s']:.0f} s{work}.")
    if finality.get("clock_error_s"):
        told.append(f"{name}: {clock_words(finality['clock_error_s'])} {Finding('CLOCK_SKEW', name, '').next_step}")
    told += [sentence for _, sentence in refusals_of(name, status)]
    if status.get("custody_failing"):
        told.append(
            f"{name}'s custodian cannot work ({status['custody_failing']}): see blockrobot custody status {name}"
        )
    height = status.get("suspended_height")
    if height is not None:
        back = f"a majority brings it back: blockrobot producer approve {name} --as ORG"
        told.append(f"{name} is suspended since height {height} and leads nothing; {back}")
    return told
