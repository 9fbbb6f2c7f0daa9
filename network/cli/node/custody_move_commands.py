"""`blockrobot node move-custody`: moves a stopped node's custodian to another store or its clips to another place."""

from __future__ import annotations

import asyncio
from pathlib import Path
from urllib.parse import urlsplit

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXISTING_FILE, command_output, console, print_answer, status_line
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import folder_option
from network.cli.node.node_answers import NodeMoveCustodyAnswer
from network.cli.node.node_commands import get_node_config
from node.clips_place import REGION_DEFAULT, ClipsPlace, read_place
from node.config import NodeConfig, load_config
from node.custody.moving import MOVED_NAME, count_moved, finish_move, give_up_move, move_custody
from node.storage.directory_lock import DirectoryLock

IN_THE_STORE = "store"


@click.command("move-custody")
@click.argument("node")
@click.option("--store", help="Its new store: sqlite, or mongodb://... for an empty database. Default: the one it has.")
@click.option(
    "--clips",
    help="Where its clips' ciphertexts are to lie: store, folder:PATH or s3://BUCKET/PREFIX. Default: where they are.",
)
@click.option("--clips-endpoint", default="", help="The S3 server's URL. Default: AWS.")
@click.option("--clips-region", default=REGION_DEFAULT, show_default=True, help="The S3 server's region.")
@click.option("--clips-ca", type=EXISTING_FILE, help="Certificates that the S3 server's is checked by.")
@click.option("--clips-credentials", type=EXISTING_FILE, help="A file with the two AWS keys under [default].")
@click.option("--give-up", "is_given_up", is_flag=True, help="Delete what a move that was cut off has copied.")
@folder_option
@command_output
def move(
    node: str,
    store: str | None,
    clips: str | None,
    clips_endpoint: str,
    clips_region: str,
    clips_ca: Path | None,
    clips_credentials: Path | None,
    is_given_up: bool,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Move what a stopped node keeps as a custodian to another store, or its clips to another place. No clip is lost.

    All is copied and compared before node.toml names the new place; cut off, the same command begins again, and
    --give-up deletes what was copied. What it kept before stays in custody.moved until you delete it.

    Example: blockrobot node move-custody node-2 --clips s3://ward/node-2 --clips-endpoint https://s3.hospital.example
    """
    if clips is None and (clips_endpoint or clips_ca or clips_credentials):
        raise click.UsageError("An S3 server's options need --clips s3://BUCKET/PREFIX.")
    if is_given_up and (clips is not None or store is not None):
        raise click.UsageError("--give-up takes no new place: name that afterwards.")
    before = config = get_node_config(node, folder)
    lock = DirectoryLock(config.data_dir)
    try:
        if is_given_up:
            asyncio.run(give_up_move(config))
            _tell_given_up(config.name, as_json=as_json)
            return
        is_finished = finish_move(config.data_dir)
        if is_finished:
            config = load_config(config.data_dir)
        if config.custodian_key_path is None:
            raise BlockRobotError("NOT_FOUND", f"{config.name} is no custodian.")
        place = config.clips
        if clips == IN_THE_STORE:
            place = None
        elif clips is not None:
            place = read_place(
                clips,
                config.data_dir,
                endpoint=clips_endpoint,
                region=clips_region,
                ca_path=None if clips_ca is None else clips_ca.resolve(),
                credentials_path=None if clips_credentials is None else clips_credentials.resolve(),
            )
        store = store or config.custody_store
        if is_finished and (store, place) == (config.custody_store, config.clips):
            counts = asyncio.run(count_moved(config))
        else:
            with status_line("Copying", as_json=as_json) as say:
                tell = lambda done, count: say(f"Copied and compared {done} of {count} clips.")  # noqa: E731
                counts = asyncio.run(move_custody(config, store, place, tell))
    finally:
        lock.release()
    old, left = config.data_dir / MOVED_NAME, _find_left(before, store, place)
    if as_json:
        clips_count = counts.staged + counts.confirmed
        answer = NodeMoveCustodyAnswer(
            node=config.name, clips=clips_count, frames=counts.frames, old=str(old), left=left
        )
        print_answer(answer)
        return
    console.print(f"{escape(config.name)} has {counts.staged + counts.confirmed} clips at the new place.")
    console.print(
        f"Start it, see that `blockrobot custody scrub` finds all well, and then delete {escape(str(old))}.",
        soft_wrap=True,
    )
    for each in left:
        console.print(
            f"{escape(each)} is left as it was: delete what is of this custodian there then too.", soft_wrap=True
        )


def _find_left(config: NodeConfig, store: str, place: ClipsPlace | None) -> list[str]:
    """Return what it was moved away from, beside its own folder."""
    left = []
    if config.custody_store not in {"sqlite", store}:
        left.append(f"The MongoDB database {urlsplit(config.custody_store).path.lstrip('/')}")
    if config.clips is not None and (place is None or place.url != config.clips.url):
        left.append(config.clips.url)
    return left


def _tell_given_up(name: str, *, as_json: bool) -> None:
    if as_json:
        print_answer(NodeMoveCustodyAnswer(node=name, clips=0, frames=0, old="", left=[]))
    else:
        console.print(f"The move of {escape(name)} is given up. Its clips are where they were.")
