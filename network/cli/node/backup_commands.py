"""`blockrobot node backup | restore`."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FOLDER, command_output, console, print_answer
from network.cli.cluster.cluster_options import folder_option
from network.cli.node.node_answers import NodeBackupAnswer, NodeRestoreAnswer
from network.cli.node.node_commands import get_node_config
from network.provisioning.node_backup import (
    CUSTODY,
    KEEP_MAX_COUNT,
    KEYS,
    Tell,
    back_up,
    delete_old,
    without_password,
)
from network.provisioning.node_backup import restore as restore_node


@click.command()
@click.argument("node")
@click.option("--out", required=True, type=FOLDER, help="The backup: a new folder.")
@click.option("--with-keys", is_flag=True, help="Its keys too: then who has the backup is the node.")
@click.option(
    "--keep",
    type=click.IntRange(1, KEEP_MAX_COUNT),
    help="Afterwards delete the node's oldest backups beside it, beyond so many.",
)
@folder_option
@command_output
def backup(node: str, out: Path, with_keys: bool, keep: int | None, folder: Path | None, as_json: bool) -> None:
    """Back a node up, while it runs or not: its settings, its ledger, and what it keeps as a custodian.

    Erase keys are never in it, since they would bring erased pictures back, and keys only with --with-keys.

    Example: blockrobot node backup node-2 --out /backup/node-2
    """
    config = get_node_config(node, folder)
    made = back_up(config, out.resolve(), with_keys=with_keys, tell=_teller(as_json=as_json))
    deleted = [] if keep is None else delete_old(out.resolve(), made, keep)
    store_elsewhere = config.custodian_key_path is not None and config.custody_store != "sqlite"
    password_left_out = without_password(config.custody_store) != config.custody_store
    if as_json:
        answer = NodeBackupAnswer(
            node=made.node,
            folder=str(out),
            height=made.height,
            files=len(made.files),
            has_keys=made.has(KEYS),
            has_custody=made.has(CUSTODY),
            store_elsewhere=store_elsewhere,
            password_left_out=password_left_out,
            deleted=[str(place) for place in deleted],
        )
        print_answer(answer)
        return
    what = " and its clips, which nobody can open without its erase keys" if made.has(CUSTODY) else ""
    console.print(
        f"{escape(made.node)} up to block {made.height}{what}: {len(made.files)} files in {escape(str(out))}."
    )
    if not made.has(KEYS):
        console.print("Its keys are not in it: keep a copy of its folder keys/ elsewhere, once.")
    if store_elsewhere:
        console.print(
            "What it keeps as a custodian is in MongoDB, and not in it. Next step: back that up by mongodump."
        )
    if password_left_out:
        console.print("The password of MongoDB is not in it: put that into node.toml again after a restore.")
    for place in deleted:
        console.print(f"Deleted: {escape(str(place))}.")


@click.command()
@click.argument("place", metavar="BACKUP", type=FOLDER)
@click.option("--data-dir", required=True, type=FOLDER, help="The data directory to make: a new folder.")
@click.option("--keys", type=FOLDER, help="The node's keys, if they are not in the backup.")
@click.option("--erase-keys", type=FOLDER, help="The newest folder erase-keys that is left of the node.")
@command_output
def restore(place: Path, data_dir: Path, keys: Path | None, erase_keys: Path | None, as_json: bool) -> None:
    """Make a node of a backup, on a host where nothing of it is left. The ledger is proved first.

    A custodian whose erase keys are lost begins without clips, and fetches them from the other custodians.

    Example: blockrobot node restore /backup/node-2 --data-dir /srv/node-2 --keys /safe/node-2/keys
    """
    made = restore_node(
        place.resolve(), data_dir.resolve(), keys=keys, erase_keys=erase_keys, tell=_teller(as_json=as_json)
    )
    run = f"blockrobot node run {shlex.quote(str(data_dir))} --restored"
    if as_json:
        answer = NodeRestoreAnswer(
            node=made.config.name,
            data_dir=str(data_dir),
            height=made.height,
            has_custody=made.has_custody,
            next_step=run,
        )
        print_answer(answer)
        return
    console.print(f"{escape(made.config.name)} is in {escape(str(data_dir))}, up to block {made.height}.")
    console.print(f"Make sure that it runs nowhere else. Next step: {escape(run)}", soft_wrap=True)


def _teller(*, as_json: bool) -> Tell:
    def tell(step: str) -> None:
        if not as_json and console.is_terminal:
            console.print(f"  {step} ...")

    return tell
