"""`blockrobot node prune` and `node diff`: prunes or compares a ledger."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable
from pathlib import Path

import click

from clients.sdk.terminal.terminal import EXIT_FAILED, command_output, console, print_answer, status_line
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import folder_option
from network.cli.node.node_answers import NodePruneAnswer
from network.cli.node.node_commands import get_node_config
from network.ledger_diff.block_replay import Base, base_of_genesis, base_of_snapshot
from network.ledger_diff.difference_answers import DifferingKey, NodeDiffAnswer
from network.ledger_diff.ledger_comparison import newest_height
from network.ledger_diff.ledger_difference import LedgerDiff, describe_difference
from node.config import KEEP_BLOCKS_MIN_COUNT, NodeConfig, load_genesis
from node.execution.sandboxed_contracts import open_sandboxed_machine
from node.retention.pruning import PRUNE_SLACK_COUNT, PrunedLedger, prune_stopped_node, request_pruning
from node.snapshot.snapshot_format import SnapshotFolder
from node.storage.directory_lock import DirectoryLock
from node.storage.lmdb_reader import LedgerFile

RUNNING_TIMEOUT_S = 60.0
_POLL_S = 0.1


@click.command()
@click.argument("node")
@click.option(
    "--keep",
    required=True,
    type=click.IntRange(KEEP_BLOCKS_MIN_COUNT),
    help="How many of the newest blocks keep their bodies.",
)
@folder_option
@command_output
def prune(node: str, keep: int, folder: Path | None, as_json: bool) -> None:
    """Drop the bodies and receipts of a node's old blocks; headers, certificates, state and audit stay.

    A running node is asked to do so within its own work. Unless it is an archive it drops by itself what is older than
    any record may be; this command drops more.

    Example: blockrobot node prune node-3 --keep 10000
    """
    config = get_node_config(node, folder)
    if config.archive:
        raise BlockRobotError("NODE_IS_ARCHIVE", f"{config.name} is an archive: it keeps every block.")
    try:
        lock = DirectoryLock(config.data_dir)
    except BlockRobotError as error:
        if error.code != "DATA_DIRECTORY_IN_USE":
            raise
        result = _prune_running(config, keep)
    else:
        try:
            result = asyncio.run(prune_stopped_node(config, keep))
        finally:
            lock.release()
    if as_json:
        answer = NodePruneAnswer(
            node=config.name,
            height=result.height,
            earliest_height=result.earliest_height,
            held_back_by_custody=result.held_back_by_custody,
        )
        print_answer(answer)
        return
    console.print(f"{config.name} has the bodies of blocks {result.earliest_height} to {result.height}.")
    if result.held_back_by_custody:
        console.print("Its custodian has not followed further; let the node run and catch up, and prune again.")


def _prune_running(config: NodeConfig, keep: int) -> PrunedLedger:
    """Raises NODE_NOT_READY."""
    request = request_pruning(config.data_dir, keep)
    deadline = time.monotonic() + RUNNING_TIMEOUT_S
    while request.exists():
        if time.monotonic() > deadline:
            request.unlink(missing_ok=True)
            raise BlockRobotError("NODE_NOT_READY", "The node did not prune in time.")
        time.sleep(_POLL_S)
    with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as view:
        head, earliest = newest_height(view), view.earliest_height
    held_back = earliest < head - keep + 1 - PRUNE_SLACK_COUNT
    return PrunedLedger(head, earliest, held_back_by_custody=held_back)


@click.command()
@click.argument("first", metavar="A")
@click.argument("second", metavar="B")
@click.option("--base", type=click.Path(path_type=Path), help="A snapshot to replay from, where old blocks are pruned.")
@click.option(
    "--full", is_flag=True, help="Look at every page of both state tries, also where nothing seems to differ."
)
@folder_option
@command_output
def diff(first: str, second: str, base: Path | None, full: bool, folder: Path | None, as_json: bool) -> None:
    """Name the first block and state key on which nodes A and B differ, and the transaction that wrote it.

    Both may be running or stopped. Exits 0 if nothing differs, 1 if something does.

    Example: blockrobot node diff node-1 node-2
    """
    configs = (get_node_config(first, folder), get_node_config(second, folder))
    if configs[0].data_dir == configs[1].data_dir:
        raise click.UsageError("A and B are the same node.")
    with status_line("Comparing ...", as_json=as_json) as show:

        def progress(height: int) -> None:
            show(f"Executing block {height} again ...")

        report = _compare(configs, base, full=full, progress=progress)
    if as_json:
        print_answer(report, ok=report.same)
    else:
        _print_report(report)
    if not report.same:
        sys.exit(EXIT_FAILED)


def _compare(
    configs: tuple[NodeConfig, NodeConfig], base: Path | None, *, full: bool, progress: Callable[[int], None]
) -> NodeDiffAnswer:
    genesis, other = (load_genesis(config) for config in configs)
    if genesis.chain_id != other.chain_id:
        raise BlockRobotError("SNAPSHOT_OTHER_CHAIN", "The two nodes have different genesis files.")

    def open_base() -> Base:
        return base_of_genesis(genesis) if base is None else base_of_snapshot(SnapshotFolder(base), genesis)

    names = tuple(config.name for config in configs)
    if names[0] == names[1]:
        names = tuple(str(config.data_dir) for config in configs)
    with (
        LedgerFile(configs[0].ledger_dir) as one,
        LedgerFile(configs[1].ledger_dir) as two,
        one.snapshot() as first,
        two.snapshot() as second,
        open_sandboxed_machine(configs[0], genesis, one) as machine,
    ):
        diff = LedgerDiff((first, second), machine, open_base, progress, full=full)
        return describe_difference(diff.run(), (names[0], names[1]), (first, second))


def _print_report(report: NodeDiffAnswer) -> None:
    names, heights = report.nodes, report.heights
    for side in "AB":
        console.print(f"{side} is {names[side]}, at height {heights[side]}.")
    for note in report.notes:
        console.print(note)
    if report.kind == "none":
        since = report.headers_compared_from
        scope = f"headers from {since}, bodies from {report.bodies_compared_from}"
        if report.same:
            console.print(f"They are the same: {scope}, and the whole state.")
        else:
            console.print(f"Their blocks are the same ({scope}); their states were not compared.")
        return
    least = " at most" if report.first_block_is_at_most else ""
    console.print(f"They differ ({report.kind}). First block: {report.first_block}{least}.")
    for side, header in (report.headers or {}).items():
        if header is not None:
            console.print(f"  {side}: block {header.block_id} of round {header.round}, epoch {header.epoch}")
    if report.right:
        console.print(f"  {report.right} has what the header names.")
    for page in report.damaged_pages or []:
        console.print(f"  damaged page of the state trie: {page}")
    keys = report.keys or []
    for key in keys[:20]:
        _print_key(key)
    if len(keys) > 20 or not report.keys_are_all:
        console.print("  ... and more keys; --json lists them.")


def _print_key(key: DifferingKey) -> None:
    console.print(f"Key {key.key} of contract {key.contract} (flat key {key.flat_key}):", markup=False)
    for side in "AB":
        right = ", as the header proves" if key.right == side else ""
        console.print(f"  {side}: {key.values[side]}{right}", markup=False)
        writer = key.written_by[side]
        if writer is not None and (side == "A" or writer != key.written_by["A"]):
            cause = f"transaction {writer.txid} ({writer.call})" if writer.txid else "the block itself"
            console.print(f"     written in block {writer.height} by {cause}", markup=False)
