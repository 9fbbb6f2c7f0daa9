"""Changes one byte of a stored ciphertext at every custodian. For demonstrations only."""

from __future__ import annotations

import sqlite3
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

from pymongo import MongoClient
from pymongo.errors import PyMongoError

from network.cluster import Cluster
from node.config import NodeConfig
from node.custody.stores.open_store import MONGO_SCHEMES
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME

DROP_MAX_MS = 3_000


def flip_stored_byte(config: NodeConfig, record_id: bytes, index: int) -> None:
    if config.custody_store.startswith(MONGO_SCHEMES):
        _flip_in_mongo(config.custody_store, record_id, index)
    else:
        _flip_in_sqlite(config.custody_dir, record_id, index)


def _flipped(ciphertext: bytes) -> bytes:
    middle = len(ciphertext) // 2
    return ciphertext[:middle] + bytes([ciphertext[middle] ^ 1]) + ciphertext[middle + 1 :]


def _flip_in_sqlite(folder: Path, record_id: bytes, index: int) -> None:
    path = folder / DATABASE_FILE_NAME
    place = (record_id, index)
    with sqlite3.connect(path, timeout=10) as database:
        select = "SELECT ciphertext FROM frames WHERE record_id = ? AND place = ?"
        (ciphertext,) = database.execute(select, place).fetchone()
        own = "(SELECT id FROM frames WHERE record_id = ? AND place = ?)"
        update = f"UPDATE stored_frames SET ciphertext = ? WHERE id = {own}"  # noqa: S608
        database.execute(update, (_flipped(ciphertext), *place))
    database.close()


def drop_databases(cluster: Cluster) -> None:
    for node in cluster.genesis.custodians:
        uri = cluster.config(node.name).custody_store
        if uri.startswith("mongodb"):
            # A server that is gone cannot be tidied up, and its absence was a failed check already.
            with (
                suppress(PyMongoError),
                MongoClient[dict[str, object]](uri, serverSelectionTimeoutMS=DROP_MAX_MS) as client,
            ):
                client.drop_database(urlsplit(uri).path.lstrip("/"))


def _flip_in_mongo(uri: str, record_id: bytes, index: int) -> None:
    name = urlsplit(uri).path.lstrip("/")
    with MongoClient[dict[str, object]](uri) as client:
        frames = client[name]["frames"]
        row = frames.find_one({"record_id": record_id, "index": index})
        if row is None:
            raise LookupError("the frame is not in the store")
        ciphertext = row["ciphertext"]
        assert isinstance(ciphertext, bytes)
        frames.update_one({"_id": row["_id"]}, {"$set": {"ciphertext": _flipped(ciphertext)}})
