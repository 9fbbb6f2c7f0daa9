"""`blockrobot custody`: custodians' status, proofs of storage and repair.

Reading a custodian's data directory authorizes: the operator's token is there.
"""

from __future__ import annotations

import asyncio
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import click
import msgspec
from rich.table import Table

from clients.sdk.terminal.lazy_group import LazyCommand, LazyGroup
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXISTING_FILE, EXIT_FAILED, command_output, console, print_json, status_line
from clients.sdk.terminal.terminal import load_genesis as load_genesis_file
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import folder_option, network_folder
from network.cli.cluster.remote_table import ask_elsewhere, ask_from_outside, print_elsewhere
from network.cli.custody.record_id import RECORD_ID
from network.cli.node.node_commands import get_node_config
from network.cluster import Cluster
from network.custody.custody_requests import R, ask_all, run_work
from network.custody.custody_text import describe_position, rebuild_sentences, scrub_sentences, status_sentences
from network.provisioning.node_joining import newest_directory
from node.config import NodeConfig, load_genesis
from node.custody.coordination.custody_answers import CustodyStatus, Progress, RebuildAnswer, ScrubAnswer

_DAYS_SHOWN_MAX = 3_650

_PLACES = {
    "status": LazyCommand(
        "network.cli.custody.custody_commands:status",
        "Show how far each custodian is behind the chain, what it holds and lacks, and which erasures are overdue.",
    ),
    "scrub": LazyCommand(
        "network.cli.custody.custody_commands:scrub",
        "Prove now that chain and store agree, and that of what was erased no ciphertext and no key is left.",
    ),
    "rebuild": LazyCommand(
        "network.cli.custody.custody_commands:rebuild",
        "Make a custodian's index again from the chain's state, erase what the chain has erased, fetch what is missing.",
    ),
    "hunt": LazyCommand(
        "network.cli.custody.custody_hunt_commands:hunt",
        "Search every file and database of a local network for anything of these records, and say what may be there.",
    ),
}


@click.group(cls=LazyGroup, places=_PLACES)
def custody() -> None:
    """See what custodians keep, prove what they erased, and mend what they lost.

    NODE is a node's data directory, or its name in the local network; without one, all custodians of the network.

    Example: blockrobot custody status
    """


def _custodians(node: str | None, folder: Path | None, *, may_lack: bool = False) -> list[NodeConfig]:
    """Raises CLUSTER_NOT_RUNNING, NOT_FOUND, and CUSTODY_ELSEWHERE unless without a name there `may_lack` any."""
    configs = [get_node_config(node, folder)] if node else list(Cluster(network_folder(folder)).configs.values())
    found = [config for config in configs if config.custodian_key_path is not None]
    if not found and (node or not may_lack):
        named = f"{configs[0].name} keeps no clips." if node else "No node here keeps clips."
        raise BlockRobotError("CUSTODY_ELSEWHERE", named)
    return found


@click.command()
@click.argument("node", required=False)
@folder_option
@click.option("--genesis", "outside", type=EXISTING_FILE, help="Ask the nodes of this genesis file, from outside.")
@command_output
def status(node: str | None, folder: Path | None, outside: Path | None, as_json: bool) -> None:
    """Show how far each custodian is behind the chain, what it holds and lacks, and which erasures are overdue.

    Custodians that are not in this folder are listed with what they tell everybody.
    Exits 0 if every custodian here answers, is up to date and owes no overdue erasure; with --genesis if any answers; 1
    otherwise.

    Example: blockrobot custody status --json
    """
    if outside is not None:
        if node or folder is not None:
            raise click.UsageError("--genesis asks from outside: without NODE and --dir.")
        _show_from_outside(outside, as_json=as_json)
        return
    configs = _custodians(node, folder, may_lack=True)
    answers = asyncio.run(ask_all(configs))
    if len(configs) == 1 and isinstance(answers[0], BlockRobotError):
        raise answers[0]
    elsewhere = []
    if not node:
        cluster = Cluster(network_folder(folder))
        elsewhere = [other for other in ask_elsewhere(cluster, quiet=as_json) if other.custodian is not False]
    directory = newest_directory(load_genesis(configs[0]), configs) if configs else None
    members = {} if directory is None else {each.custodian_key.hex(): each.name for each in directory.nodes.values()}
    sentences = status_sentences([config.name for config in configs], answers, members)
    if as_json:
        rows = [
            {"name": config.name, "error": answer.code} if isinstance(answer, BlockRobotError) else answer
            for config, answer in zip(configs, answers, strict=True)
        ]
        document = {"custodians": msgspec.to_builtins(rows), "elsewhere": msgspec.to_builtins(elsewhere)}
        print_json({"ok": not sentences, **document, "problems": sentences})
    else:
        if configs:
            _print_status(configs, answers)
        else:
            console.print("No node here keeps clips.")
        print_elsewhere(elsewhere)
        if elsewhere:
            console.print("What those hold they say on their own machines: blockrobot custody status.")
        for sentence in sentences:
            console.print(escape(sentence))
    if sentences:
        sys.exit(EXIT_FAILED)


def _show_from_outside(genesis: Path, *, as_json: bool) -> None:
    asked = ask_from_outside(load_genesis_file(genesis), quiet=as_json)
    elsewhere = [other for other in asked if other.custodian is not False]
    is_answered = any(other.problem is None for other in elsewhere)
    if as_json:
        print_json({"ok": is_answered, "custodians": [], "elsewhere": msgspec.to_builtins(elsewhere), "problems": []})
    else:
        print_elsewhere(elsewhere)
    if not is_answered:
        sys.exit(EXIT_FAILED)


def _print_status(configs: list[NodeConfig], answers: list[CustodyStatus | BlockRobotError]) -> None:
    table = Table(title="Custodians", title_justify="left", pad_edge=False, collapse_padding=True)
    for column in ("node", "position"):
        table.add_column(column, no_wrap=True)
    for column in ("held", "staged", "missing", "erased", "outbox", "overdue", "keys", "store"):
        table.add_column(column, justify="right")
    for config, answer in zip(configs, answers, strict=True):
        if isinstance(answer, BlockRobotError):
            table.add_row(config.name, "no answer" if answer.code == "NODE_UNREACHABLE" else answer.code, *"--------")
            continue
        counts = [answer.clips_held, answer.clips_staged, answer.clips_missing, answer.clips_erased]
        own = answer.waiting_for.get(answer.member)
        size = "-" if answer.store_bytes is None else f"{answer.store_bytes / 1e6:.1f} MB"
        cells = [*counts, answer.outbox_ready, 0 if own is None else len(own.overdue), answer.slots_used, size]
        table.add_row(config.name, describe_position(answer), *(str(cell) for cell in cells))
    console.print(table)
    _print_uploads(configs, answers)


def _print_uploads(configs: list[NodeConfig], answers: list[CustodyStatus | BlockRobotError]) -> None:
    table = Table(title="Uploads", title_justify="left", pad_edge=False, collapse_padding=True)
    for column in ("node", "organisation", "robot"):
        table.add_column(column, no_wrap=True)
    for column in ("staged", "held", "today", "a day", "refused"):
        table.add_column(column, justify="right")
    lines = []
    for config, answer in zip(configs, answers, strict=True):
        if isinstance(answer, BlockRobotError):
            continue
        for row in answer.uploads:
            held_bytes = 0 if row.held_bytes is msgspec.UNSET else row.held_bytes
            sizes = [
                f"{size / 1e6:.1f} MB" for size in (row.staged_bytes, held_bytes, row.today_bytes, row.bytes_a_day)
            ]
            robot = f"{row.robot[:12]}..." if row.robot else "(fetched)"
            table.add_row(config.name, escape(row.organisation), robot, *sizes, str(row.refused))
        if answer.disk_free_bytes is not None:
            days = answer.days_until_reserve
            shown = "more than ten years" if days is not None and days > _DAYS_SHOWN_MAX else f"{days} days"
            lasts = "" if days is None else f", which last {shown} at {answer.bytes_a_day / 1e9:.2f} GB a day"
            free, reserve = ((size or 0) / 1e9 for size in (answer.disk_free_bytes, answer.disk_reserve_bytes))
            lines.append(f"{config.name}: {free:.1f} GB are free, {reserve:.1f} GB of them are kept back{lasts}.")
    if table.row_count:
        console.print(table)
    for line in lines:
        console.print(escape(line))


def _run(
    configs: list[NodeConfig], kind: type[R], work: str, *, as_json: bool, after: bytes = b""
) -> list[tuple[str, R]]:
    reports, last = [], dict[str, str]()
    try:
        with status_line("Asking ...", as_json=as_json) as show:

            def on_progress(name: str, progress: Progress) -> None:
                last[name] = progress.last or last.get(name, "")
                show(f"{name}: {progress.what} {progress.done}{f' of {progress.total}' if progress.total else ''}")

            for config in configs:
                on_progress(config.name, Progress(what=work, done=0, total=0))
                reports.append((config.name, asyncio.run(run_work(config, kind, on_progress, after=after))))
    except (BlockRobotError, KeyboardInterrupt):
        config = configs[len(reports)]
        if last.get(config.name):
            go_on = shlex.join(["blockrobot", "custody", work, str(config.data_dir), "--after", last[config.name]])
            click.echo(
                f"Broken off. Until then nothing was wrong but what is listed as missing. Go on: {go_on}", err=True
            )
        raise
    return reports


@click.command()
@click.argument("node", required=False)
@folder_option
@click.option("--after", type=RECORD_ID, help="Go on after this record, which NODE's scrub told when it broke off.")
@command_output
def scrub(node: str | None, folder: Path | None, after: bytes | None, as_json: bool) -> None:
    """Prove now that chain and store agree, and that of what was erased no ciphertext and no key is left.

    Looks at every record both ways, every frame's bytes, every slot of the erase keys and, in SQLite, every free page.
    Lists as missing what is missing, and deletes blobs that no row names; else it changes nothing. Exits 0 if all is as
    it must be, 1 otherwise.

    With --after, records are looked at from there on, in the order of their ids, and all else once more.

    Example: blockrobot custody scrub node-1
    """
    if after and not node:
        raise click.UsageError("--after is a record of one node's scrub: name the node.")
    reports = _run(_custodians(node, folder), ScrubAnswer, "scrub", as_json=as_json, after=after or b"")
    _finish(reports, scrub_sentences, as_json=as_json)


@click.command()
@click.argument("node")
@folder_option
@command_output
def rebuild(node: str, folder: Path | None, as_json: bool) -> None:
    """Make a custodian's index again from the chain's state, erase what the chain has erased, fetch what is missing.

    The node goes on meanwhile; its custodian follows no block while the index is made. Can be repeated at any time.
    Exits 0 if the store then has all that the chain says and no more, 1 otherwise.

    Example: blockrobot custody rebuild node-2
    """
    reports = _run(_custodians(node, folder), RebuildAnswer, "rebuild", as_json=as_json)
    _finish(reports, rebuild_sentences, as_json=as_json)


def _finish(reports: list[tuple[str, R]], sentences: Callable[[str, R], list[str]], *, as_json: bool) -> None:
    is_well = all(report.ok for _, report in reports)
    if as_json:
        rows = [{"node": name, **msgspec.to_builtins(report)} for name, report in reports]
        print_json({"ok": is_well, "custodians": rows})
    else:
        for name, report in reports:
            for sentence in sentences(name, report):
                console.print(escape(sentence))
    if not is_well:
        sys.exit(EXIT_FAILED)
