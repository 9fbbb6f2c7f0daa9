"""Opens the custody store that a node's configuration names; never prints its URI (password)."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast

from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace
from node.custody.blobs.blob_backed_store import BlobBackedStore
from node.custody.blobs.blob_store import BlobStore
from node.custody.blobs.folder_blobs import FolderBlobs
from node.custody.blobs.place_file import open_names, require_place
from node.custody.stores.custody_store import CustodyStore
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME, SqliteStore

if TYPE_CHECKING:
    from node.custody.stores.mongo_store import MongoStore

MONGO_SCHEMES = ("mongodb://", "mongodb+srv://")


def open_store(
    uri: str, folder: Path, require_space: Callable[[], None] = lambda: None, clips: ClipsPlace | None = None
) -> CustodyStore:
    """Return a store (`sqlite` in `folder`, or MongoDB URI) for `async with`; `clips`: where ciphertexts lie apart from it.

    `require_space` precedes embedded writes and may raise OSError. Raises EXTRA_MISSING, and
    CONFIGURATION_INVALID, also for clips that are somewhere else.
    """
    index = open_index(uri, folder, require_space)
    require_place(folder, clips)
    if clips is None:
        return index
    # What it does not define is the index's.
    return cast("CustodyStore", BlobBackedStore(index, open_blobs(clips), open_names(folder, clips), folder))


def open_index(uri: str, folder: Path, require_space: Callable[[], None] = lambda: None) -> CustodyStore:
    """The store itself: where clips lie apart, with references in place of ciphertexts."""
    if uri == "sqlite":
        return SqliteStore(folder, require_space)
    if uri.startswith(MONGO_SCHEMES):
        return _open_mongo(uri)
    raise BlockRobotError("CONFIGURATION_INVALID", "The custody store is sqlite or the URI of a MongoDB database.")


async def clear_index(uri: str, folder: Path) -> None:
    """Leave an index of nothing. Raises STORE_UNAVAILABLE."""
    if uri.startswith(MONGO_SCHEMES):
        async with _open_mongo(uri) as index:
            await index.clear()
    else:
        _remove_database(folder)


def _remove_database(folder: Path) -> None:
    for path in folder.glob(f"{DATABASE_FILE_NAME}*"):
        path.unlink()


def _open_mongo(uri: str) -> MongoStore:
    from node.custody.stores.mongo_store import MongoStore  # noqa: PLC0415 - pymongo is a sixth of a node's start

    return MongoStore(uri)


def open_blobs(place: ClipsPlace) -> BlobStore:
    """Raises EXTRA_MISSING."""
    if place.folder is not None:
        return FolderBlobs(place.folder)
    try:
        from node.custody.blobs.s3_blobs import S3Blobs  # noqa: PLC0415 - the optional extra, only when used
    except ImportError:
        detail = "Clips in S3 need the package aiobotocore: `make install-s3` in your clone."
        raise BlockRobotError("EXTRA_MISSING", detail) from None
    return S3Blobs(place)


def mongo_options(uri: str) -> list[str]:
    """As pymongo parts them: by & or ;, and where there is neither, by white space. Names are in any case."""
    options = uri.partition("?")[2]
    return re.split("[&;]", options) if re.search("[&;]", options) else options.split()
