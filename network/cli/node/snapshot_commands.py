"""`blockrobot node snapshot`: creates, restores and inspects state snapshots."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeElapsedColumn

from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.terminal import command_output, console, load_genesis, print_answer
from network.cli.cluster.cluster_options import folder_option
from network.cli.node.node_answers import (
    SnapshotCreateAnswer,
    SnapshotManifest,
    SnapshotRestoreAnswer,
    SnapshotShowAnswer,
)
from network.cli.node.node_commands import get_node_config
from node.config import load_genesis as load_own_genesis
from node.snapshot.checking import restore_into, verify_head
from node.snapshot.making import describe_manifest, make_snapshot_folder
from node.snapshot.restoring import restore_ledger
from node.snapshot.snapshot_format import Manifest, SnapshotFolder, read_manifest
from node.storage.directory_lock import DirectoryLock
from node.storage.lmdb_reader import LedgerFile


class _Bar:
    """Shown only on a terminal without --json."""

    def __init__(self, what: str, *, as_json: bool) -> None:
        columns = (TextColumn(what), BarColumn(), DownloadColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=console, disable=as_json or not console.is_terminal, transient=True)
        self._task = self._bar.add_task(what, total=None)

    def __enter__(self) -> _Bar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def expect(self, size_bytes: int) -> None:
        self._bar.update(self._task, total=size_bytes)

    def __call__(self, _chunks: int, size_bytes: int) -> None:
        self._bar.update(self._task, completed=size_bytes)


def _manifest_answer(manifest: Manifest) -> SnapshotManifest:
    return msgspec.convert(describe_manifest(manifest), SnapshotManifest)


@click.group()
def snapshot() -> None:
    """Bring a node to a block's state without the blocks before it.

    Example: blockrobot node snapshot create node-1 --out node-1.snapshot
    """


@snapshot.command()
@click.argument("node")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="The folder to make.")
@folder_option
@command_output
def create(node: str, out: Path, folder: Path | None, as_json: bool) -> None:
    """Make a snapshot of a node's newest finalized state, while it runs or not.

    Example: blockrobot node snapshot create node-1 --out node-1.snapshot
    """
    config = get_node_config(node, folder)
    with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as view, _Bar("Writing", as_json=as_json) as bar:
        manifest = make_snapshot_folder(view, out.resolve(), bar)
    if as_json:
        print_answer(extend(SnapshotCreateAnswer, _manifest_answer(manifest), folder=str(out)))
        return
    console.print(
        f"Snapshot of block {manifest.height} in {out}: {manifest.state_row_count} rows of state, "
        f"{manifest.size_bytes / 1e6:.1f} MB in {len(manifest.chunks)} chunks."
    )


@snapshot.command()
@click.argument("node")
@click.argument("path", type=click.Path(path_type=Path))
@folder_option
@command_output
def restore(node: str, path: Path, folder: Path | None, as_json: bool) -> None:
    """Put a snapshot in the place of a stopped node's ledger; keys, journal and custody stay.

    Everything is checked first, from the node's own genesis file on. After a refusal the ledger is as it was.

    Example: blockrobot node snapshot restore nodes/node-5 node-1.snapshot
    """
    config = get_node_config(node, folder)
    source = SnapshotFolder(path)
    lock = DirectoryLock(config.data_dir)
    try:
        with _Bar("Checking", as_json=as_json) as bar:
            bar.expect(read_manifest(source.manifest()).size_bytes)
            head = restore_ledger(source, load_own_genesis(config), config.ledger_dir, bar)
    finally:
        lock.release()
    if as_json:
        print_answer(extend(SnapshotRestoreAnswer, _manifest_answer(head.manifest), node=config.name))
        return
    console.print(f"{config.name} now begins with block {head.header.height}; start it, and it follows by blocks.")


@snapshot.command()
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--genesis", type=click.Path(path_type=Path), help="Verify it all against this genesis file.")
@command_output
def show(path: Path, genesis: Path | None, as_json: bool) -> None:
    """Say what a snapshot holds; with --genesis, check every byte, the proofs and the state's root as well.

    Example: blockrobot node snapshot show node-1.snapshot --genesis genesis.json
    """
    from node.storage.memory_store import MemoryRestore  # noqa: PLC0415 - holds the state in memory; only to verify

    source = SnapshotFolder(path)
    manifest = read_manifest(source.manifest())
    if genesis is not None:
        chain = load_genesis(genesis)
        verify_head(manifest, chain)
        with _Bar("Checking", as_json=as_json) as bar:
            bar.expect(manifest.size_bytes)
            restore_into(source, chain, MemoryRestore(), bar)
    if as_json:
        print_answer(extend(SnapshotShowAnswer, _manifest_answer(manifest), verified=genesis is not None))
        return
    for name, value in describe_manifest(manifest).items():
        console.print(f"{name:>16}  {value}")
    console.print("Verified from genesis on." if genesis else "Nothing of this is verified; name --genesis to do so.")
