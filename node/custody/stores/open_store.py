"""Opens the custody store that a node's configuration names; never prints its URI (password)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from consensus.errors import BlockRobotError
from node.custody.stores.custody_store import CustodyStore
from node.custody.stores.sqlite_store import SqliteStore

MONGO_SCHEMES = ("mongodb://", "mongodb+srv://")


def open_store(uri: str, folder: Path, require_space: Callable[[], None] = lambda: None) -> CustodyStore:
    """Return a store (`sqlite` in `folder`, or MongoDB URI) for `async with`.

    `require_space` precedes embedded writes and may raise OSError. Raises CONFIGURATION_INVALID.
    """
    if uri == "sqlite":
        return SqliteStore(folder, require_space)
    if uri.startswith(MONGO_SCHEMES):
        from node.custody.stores.mongo_store import MongoStore  # noqa: PLC0415 - pymongo is a sixth of a node's start

        return MongoStore(uri)
    raise BlockRobotError("CONFIGURATION_INVALID", "The custody store is sqlite or the URI of a MongoDB database.")
