"""The file that says where the clips are that a custodian's index refers to, and the key of their names."""

from __future__ import annotations

import secrets
from pathlib import Path

import msgspec

from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace, invalid_place
from node.custody.blobs.blob_names import KEY_BYTES, BlobNames
from node.custody.blobs.blob_store import OWNER_NAME, BlobStore
from node.storage.synced_files import write_synced

PLACE_FILE_NAME = "clips.json"
PLACE_FILE_MAX_BYTES = 4096
OWNER_MAX_BYTES = 256


class PlaceFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`custody/clips.json`: where the clips that the index refers to are, and the key of their names (hex).

    `is_new`: the place has not been taken yet. Later, one without its owner's file is another than the one that was.
    """

    url: str
    names_key: str
    is_new: bool = False


def require_place(custody_dir: Path, place: ClipsPlace | None) -> None:
    """Raise CONFIGURATION_INVALID if the index refers to clips that are somewhere else."""
    known = read_place_file(custody_dir)
    url = "" if place is None else place.url
    if known is not None and not known.is_new and known.url != url:
        detail = f"the clips of this custodian are in {known.url}. Name that, or move them by `node move-custody`."
        raise invalid_place(detail)


def read_place_file(custody_dir: Path) -> PlaceFile | None:
    """Raises CONFIGURATION_INVALID for a damaged one, STORE_UNAVAILABLE."""
    path = custody_dir / PLACE_FILE_NAME
    try:
        return msgspec.convert(read_json_text(path.read_bytes(), PLACE_FILE_MAX_BYTES), PlaceFile)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise BlockRobotError("STORE_UNAVAILABLE", f"{path} fails: {error.strerror}.") from error
    except (ValueError, BlockRobotError) as error:
        raise invalid_place(f"{path} is damaged; take it from a backup of this node.") from error


def open_names(custody_dir: Path, place: ClipsPlace) -> BlobNames:
    """Make the key of the names at first, and anew for another place before one is taken. Raises as `read_place_file`."""
    known = read_place_file(custody_dir)
    try:
        if known is None or (known.is_new and known.url != place.url):
            known = PlaceFile(place.url, secrets.token_hex(KEY_BYTES), is_new=True)
            custody_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write(custody_dir, known)
        return BlobNames(bytes.fromhex(known.names_key))
    except ValueError as error:
        raise invalid_place(f"{PLACE_FILE_NAME} is damaged; take it from a backup of this node.") from error
    except OSError as error:
        raise BlockRobotError("STORE_UNAVAILABLE", f"{custody_dir} fails: {error.strerror}.") from error


def _write(custody_dir: Path, known: PlaceFile) -> None:
    write_synced(custody_dir / PLACE_FILE_NAME, msgspec.json.encode(known))


async def take_place(blobs: BlobStore, names: BlobNames, custody_dir: Path) -> None:
    """See that a place is this custodian's; make a new one so, and one whose owner's file somebody made, empty.

    Raises CLIPS_NOT_THERE if it was used before and has no owner's file, CONFIGURATION_INVALID if it is another's.
    """
    known = read_place_file(custody_dir)
    is_new, owner = known is None or known.is_new, names.owner.encode()
    found = await blobs.get(OWNER_NAME, OWNER_MAX_BYTES)
    is_there = found is not None or await blobs.has(OWNER_NAME)
    if not is_there and not is_new:
        where = "" if known is None else f"{known.url} "
        raise BlockRobotError("CLIPS_NOT_THERE", f"The place of `clips` {where}has lost its file `{OWNER_NAME}`.")
    if not is_there or found == b"":
        await blobs.put(OWNER_NAME, owner)
    elif found != owner:
        detail = "The place of `clips` is another custodian's. Give this one a bucket, prefix or folder of its own."
        raise BlockRobotError("CONFIGURATION_INVALID", detail)
    _note(custody_dir, is_new=False)


async def leave_place(blobs: BlobStore, names: BlobNames, custody_dir: Path) -> None:
    """Delete all that this custodian has there; cut off, it can be begun again. Raises as `take_place`."""
    await take_place(blobs, names, custody_dir)
    await blobs.clear_unfinished()
    async for name in blobs.names():
        if names.read(name) is not None:
            await blobs.delete(name)
    _note(custody_dir, is_new=True)
    await blobs.delete(OWNER_NAME)


def _note(custody_dir: Path, *, is_new: bool) -> None:
    known = read_place_file(custody_dir)
    if known is None or known.is_new == is_new:
        return
    try:
        _write(custody_dir, msgspec.structs.replace(known, is_new=is_new))
    except OSError as error:
        raise BlockRobotError("STORE_UNAVAILABLE", f"{custody_dir} fails: {error.strerror}.") from error
