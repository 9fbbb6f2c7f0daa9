"""Moves a stopped node's custodian to another store, or its clips to another place, without losing a clip."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace
from node.config import CONFIG_FILE, CUSTODY_NAME, NodeConfig, config_to_toml
from node.custody.stores.copying import Tell, copy_store
from node.custody.stores.custody_store import StoreCounts
from node.custody.stores.open_store import open_store
from node.storage.synced_files import sync_directory, write_synced

MOVING_NAME, MOVED_NAME = "custody.moving", "custody.moved"
SETTINGS_NAME = "node.toml.moving"
"""Its being there says that all is copied, and the new place has only to be named."""


async def move_custody(
    config: NodeConfig, store: str, clips: ClipsPlace | None, tell: Tell = lambda _done, _all: None
) -> StoreCounts:
    """Copy, compare, and only then let `node.toml` name the new place; begun again after a crash, it goes on.

    What was before stays as `custody.moved` (and in its database, bucket or folder). The caller holds the data
    directory's lock. Raises CONFIGURATION_INVALID if nothing would change, FILE_EXISTS, STORE_UNAVAILABLE.
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
    old = open_store(config.custody_store, config.custody_dir, clips=config.clips)
    async with old as source, open_store(store, moving, clips=clips) as target:
        counts = await copy_store(source, target, tell)
    moving.mkdir(mode=0o700, exist_ok=True)
    changed = dataclasses.replace(config, custody_store=store, clips=clips)
    write_synced(config.data_dir / SETTINGS_NAME, config_to_toml(changed).encode())
    finish_move(config.data_dir)
    return counts


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
    """Raise CONFIGURATION_INVALID in the middle of a move."""
    if (data_dir / SETTINGS_NAME).exists():
        detail = "A move of its custodian was cut off: finish it by the same `blockrobot node move-custody`."
        raise BlockRobotError("CONFIGURATION_INVALID", detail)
