"""`blockrobot node backup | restore`."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXISTING_FILE, FOLDER, command_output, console, load_genesis, print_answer
from network.cli.cluster.cluster_options import folder_option, genesis_steps, network_folder
from network.cli.governance.governance_signer import plain_table
from network.cli.node.node_answers import NodeBackupAnswer, NodeRestoreAnswer
from network.cli.node.node_commands import get_node_config
from network.provisioning.founding import fingerprint
from network.provisioning.node_backup import (
    CUSTODY_DATABASE,
    KEEP_MAX_COUNT,
    KEYS,
    Tell,
    back_up,
    delete_old,
    shown_settings,
    unusual_settings,
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
    clips_elsewhere = "" if config.clips is None else config.clips.url
    password_left_out = without_password(config.custody_store) != config.custody_store
    if as_json:
        answer = NodeBackupAnswer(
            node=made.node,
            folder=str(out),
            height=made.height,
            files=len(made.files),
            has_keys=made.has(KEYS),
            has_custody=made.has(CUSTODY_DATABASE),
            store_elsewhere=store_elsewhere,
            clips_elsewhere=clips_elsewhere,
            password_left_out=password_left_out,
            deleted=[str(place) for place in deleted],
        )
        print_answer(answer)
        return
    what = ""
    if made.has(CUSTODY_DATABASE):
        kept = "its clips" if config.clips is None else "its custodian's rows"
        what = f" and {kept}, which nobody can open without its erase keys"
    console.print(
        f"{escape(made.node)} up to block {made.height}{what}: {len(made.files)} files in {escape(str(out))}."
    )
    if not made.has(KEYS):
        console.print("Its keys are not in it: keep a copy of its folder keys/ elsewhere, once.")
    if store_elsewhere:
        console.print(
            "What it keeps as a custodian is in MongoDB, and not in it. Next step: back that up by mongodump."
        )
    if clips_elsewhere:
        console.print(f"Its clips' ciphertexts are in {escape(clips_elsewhere)}, and not in it.")
    if password_left_out:
        console.print(
            "The password of MongoDB or its login is not in it: put that into node.toml again after a restore."
        )
    for place in deleted:
        console.print(f"Deleted: {escape(str(place))}.")


@click.command()
@click.argument("place", metavar="BACKUP", type=FOLDER)
@click.option("--data-dir", required=True, type=FOLDER, help="The data directory to make: a new folder.")
@click.option("--keys", type=FOLDER, help="The node's keys, if they are not in the backup.")
@click.option("--erase-keys", type=FOLDER, help="The newest folder erase-keys that is left of the node.")
@click.option("--genesis", type=EXISTING_FILE, help="The network's genesis file, of which the backup has to be.")
@click.option(
    "--outside",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A file or folder outside of the node's that its settings may name; may be given again.",
)
@command_output
def restore(
    place: Path,
    data_dir: Path,
    keys: Path | None,
    erase_keys: Path | None,
    genesis: Path | None,
    outside: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Make a node of a backup, on a host where nothing of it is left. The ledger is proved first.

    A backup that lay elsewhere may have been changed. Paths that leave the node's folder are refused, but for --outside;
    look at the other settings, which are shown, and compare the fingerprint of the network, or name its genesis file.

    A custodian whose erase keys are lost begins without clips, and fetches them from the other custodians.

    Example: blockrobot node restore /backup/node-2 --data-dir /srv/node-2 --keys /safe/node-2/keys
    """
    made = restore_node(
        place.resolve(),
        data_dir.resolve(),
        keys=keys,
        erase_keys=erase_keys,
        genesis=None if genesis is None else load_genesis(genesis),
        outside=outside,
        tell=_teller(as_json=as_json),
    )
    changed = unusual_settings(made.config)
    run = f"blockrobot node run {shlex.quote(str(data_dir))} --restored"
    if as_json:
        answer = NodeRestoreAnswer(
            node=made.config.name,
            data_dir=str(data_dir),
            height=made.height,
            has_custody=made.has_custody,
            fingerprint=fingerprint(made.genesis),
            settings=shown_settings(made.config),
            changed_settings=list(changed),
            next_step=run,
            warning=made.warning,
        )
        print_answer(answer)
        return
    console.print(f"{escape(made.config.name)} is in {escape(str(data_dir))}, up to block {made.height}.")
    table = plain_table("Its settings that are not the default", ["setting", "value"])
    for name, value in changed.items():
        table.add_row(name, escape(", ".join(value) if isinstance(value, list) else str(value)))
    console.print(table)
    console.print(f"Fingerprint of its network: {fingerprint(made.genesis)}")
    for step in genesis_steps(network_folder(None), data_dir.resolve()):
        console.print(f"So that `status` and other commands find its network here: {escape(step)}", soft_wrap=True)
    if made.warning:
        console.print(made.warning, style="red", soft_wrap=True)
    console.print(f"Make sure that it runs nowhere else. Next step: {escape(run)}", soft_wrap=True)


def _teller(*, as_json: bool) -> Tell:
    def tell(step: str) -> None:
        if not as_json and console.is_terminal:
            console.print(f"  {step} ...")

    return tell
