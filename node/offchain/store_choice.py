"""Which custody store a configuration names. Must never show a URI, which may hold a password."""

from __future__ import annotations

from pathlib import Path

from consensus.errors import BlockRobotError
from node.offchain.mongo_store import MongoStore
from node.offchain.sqlite_store import SqliteStore
from node.offchain.store import CustodyStore

EMBEDDED = "sqlite"
_MONGO_SCHEMES = ("mongodb://", "mongodb+srv://")


def choose_store(setting: str, directory: Path) -> CustodyStore:
    """Return the store, not yet opened: `sqlite` is embedded in `directory`, a MongoDB URI names server and database.

    Raises CONFIGURATION_INVALID for anything else.
    """
    if setting == EMBEDDED:
        return SqliteStore(directory)
    if setting.startswith(_MONGO_SCHEMES):
        return MongoStore(setting)
    raise BlockRobotError("CONFIGURATION_INVALID", "A custody store is `sqlite` or a URI that begins with mongodb://.")
