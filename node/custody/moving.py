"""Moves a stopped node's custodian to another store, or its clips to another place, without losing a clip."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace
from node.config import CONFIG_FILE, CUSTODY_NAME, NodeConfig, config_to_toml, load_config
from node.custody.blobs.place_file import PLACE_FILE_NAME, leave_place, open_names, read_place_file
from node.custody.stores.copying import Tell, copy_store, require_empty
from node.custody.stores.custody_store import StoreCounts
from node.custody.stores.open_store import clear_index, open_blobs, open_index, open_store
from node.storage.synced_files import UNFINISHED, sync_directory, write_synced

MOVING_NAME, MOVED_NAME = "custody.moving", "custody.moved"
SETTINGS_NAME = "node.toml.moving"
"""Its being there says that all is copied, and the new place has only to be named."""
COPYING_NAME = "node.toml.copying"
"""What it is until then: a move has begun to copy, and until it is given up, what is at its place is its own."""


async def move_custody(
    config: NodeConfig, store: str, clips: ClipsPlace | None, tell: Tell = lambda _done, _all: None
) -> StoreCounts:
    """Copy, compare, and only then let `node.toml` name the new place; cut off, it copies all anew.

    What was before stays as `custody.moved` (and in its database, bucket or folder). Clips that lie apart and stay where
    they are are not touched. The caller holds the data directory's lock.
    Raises CONFIGURATION_INVALID if nothing would change, MOVE_CUT_OFF if another move was, FILE_EXISTS, STORE_UNAVAILABLE.
    """
    moving, moved = config.data_dir / MOVING_NAME, config.data_dir / MOVED_NAME
    if (store, clips) == (config.custody_store, config.clips):
        raise BlockRobotError("CONFIGURATION_INVALID", "The custodian's store and clips are there already.")
    if store == config.custody_store and store != "sqlite":
        detail = "To move only its clips, name a new database for the index too: the old one stays whole until then."
        raise BlockRobotError("CONFIGURATION_INVALID", detail)
    if moved.exists():
        detail = f"{moved} is left of an earlier move: delete it, once nothing of it is needed."
        raise BlockRobotError("FILE_EXISTS", detail)
    planned = _read_planned(config.data_dir)
    if planned is not None and (planned.custody_store, _where(planned.clips)) != (store, _where(clips)):
        rows = "SQLite" if planned.custody_store == "sqlite" else "MongoDB"
        apart = "the store" if planned.clips is None else planned.clips.url
        detail = (
            f"A move was cut off (rows to {rows}, clips to {apart}). All is where it was: finish that move by the same "
            f"command, or give it up by `blockrobot node move-custody {config.name} --give-up`."
        )
        raise BlockRobotError("MOVE_CUT_OFF", detail)
    moving.mkdir(mode=0o700, exist_ok=True)
    _forget_live_names(config)
    if planned is not None or store == "sqlite":
        await clear_index(store, moving)
    if clips is not None and clips == config.clips:
        old, new = open_index(config.custody_store, config.custody_dir), open_index(store, moving)
        if (config.custody_dir / PLACE_FILE_NAME).exists():
            write_synced(moving / PLACE_FILE_NAME, (config.custody_dir / PLACE_FILE_NAME).read_bytes())
    else:
        old = open_store(config.custody_store, config.custody_dir, clips=config.clips)
        new = open_store(store, moving, clips=clips)
    changed = dataclasses.replace(config, custody_store=store, clips=clips)
    async with old as source, new as target:
        await require_empty(target)
        write_synced(config.data_dir / COPYING_NAME, config_to_toml(changed).encode())
        await target.sweep_blobs()
        counts = await copy_store(source, target, tell)
    (config.data_dir / COPYING_NAME).replace(config.data_dir / SETTINGS_NAME)
    sync_directory(config.data_dir)
    finish_move(config.data_dir)
    return counts


async def give_up_move(config: NodeConfig) -> None:
    """Delete what a move that was cut off has copied, so that another can be begun. What it copied from is not touched.

    Raises NO_MOVE_CUT_OFF, MOVE_CUT_OFF if it has copied all, CLIPS_NOT_THERE, STORE_UNAVAILABLE.
    """
    if (config.data_dir / SETTINGS_NAME).exists():
        detail = "The move has copied all: finish it by the same command, and then move on from there, or back."
        raise BlockRobotError("MOVE_CUT_OFF", detail)
    planned, moving = _read_planned(config.data_dir), config.data_dir / MOVING_NAME
    if planned is None:
        raise BlockRobotError("NO_MOVE_CUT_OFF")
    _forget_live_names(config)
    was_named_since = planned.custody_store == config.custody_store != "sqlite"
    if not was_named_since:
        await clear_index(planned.custody_store, moving)
    if planned.clips is not None and (moving / PLACE_FILE_NAME).exists():
        async with open_blobs(planned.clips) as blobs:
            await leave_place(blobs, open_names(moving, planned.clips), moving)
    _remove_folder(moving)
    (config.data_dir / COPYING_NAME).unlink()
    sync_directory(config.data_dir)


def _remove_folder(moving: Path) -> None:
    if moving.exists():
        for path in (moving / PLACE_FILE_NAME, *moving.glob(f"{UNFINISHED}*")):
            path.unlink(missing_ok=True)
        moving.rmdir()


def _read_planned(data_dir: Path) -> NodeConfig | None:
    return load_config(data_dir, COPYING_NAME) if (data_dir / COPYING_NAME).exists() else None


def _where(clips: ClipsPlace | None) -> tuple[str, str] | None:
    return None if clips is None else (clips.url, clips.endpoint)


def _forget_live_names(config: NodeConfig) -> None:
    """A move of the rows alone has the names of the clips that stay: none of those is a copy to be deleted."""
    copied = config.data_dir / MOVING_NAME
    live, taken = read_place_file(config.custody_dir), read_place_file(copied)
    if live is not None and taken is not None and live.names_key == taken.names_key:
        (copied / PLACE_FILE_NAME).unlink()


async def count_moved(config: NodeConfig) -> StoreCounts:
    """Of a move that was cut off when all was copied. Raises STORE_UNAVAILABLE."""
    async with open_index(config.custody_store, config.custody_dir) as index:
        return await index.counts()


def finish_move(data_dir: Path) -> bool:
    """Name the new place, if one waits for that; return whether one did."""
    settings, custody, moving = data_dir / SETTINGS_NAME, data_dir / CUSTODY_NAME, data_dir / MOVING_NAME
    if not settings.exists():
        return False
    if moving.exists():
        if custody.exists():
            custody.rename(data_dir / MOVED_NAME)
        moving.rename(custody)
        sync_directory(data_dir)
    settings.replace(data_dir / CONFIG_FILE)
    sync_directory(data_dir)
    return True


def require_no_move(data_dir: Path) -> None:
    """Raise MOVE_CUT_OFF in the middle of a move."""
    if (data_dir / SETTINGS_NAME).exists():
        detail = "A move of its custodian was cut off: finish it by the same `blockrobot node move-custody`."
        raise BlockRobotError("MOVE_CUT_OFF", detail)
