"""The file that says where the clips are that a custodian's index refers to, and the key of their names."""

from __future__ import annotations

import secrets
from pathlib import Path

import msgspec

from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace, invalid_place
from node.custody.blobs.blob_names import KEY_BYTES, BlobNames
from node.storage.synced_files import write_synced

PLACE_FILE_NAME = "clips.json"
PLACE_FILE_MAX_BYTES = 4096


class PlaceFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`custody/clips.json`: where the clips that the index refers to are, and the key of their names (hex)."""

    url: str
    names_key: str


def require_place(custody_dir: Path, place: ClipsPlace | None) -> None:
    """Raise CONFIGURATION_INVALID if the index refers to clips that are somewhere else."""
    known = read_place_file(custody_dir)
    url = "" if place is None else place.url
    if known is not None and known.url != url:
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
    """Make the key of the names at first. Raises as `read_place_file`."""
    known = read_place_file(custody_dir)
    try:
        if known is None:
            known = PlaceFile(place.url, secrets.token_hex(KEY_BYTES))
            custody_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_synced(custody_dir / PLACE_FILE_NAME, msgspec.json.encode(known))
        return BlobNames(bytes.fromhex(known.names_key))
    except ValueError as error:
        raise invalid_place(f"{PLACE_FILE_NAME} is damaged; take it from a backup of this node.") from error
    except OSError as error:
        raise BlockRobotError("STORE_UNAVAILABLE", f"{custody_dir} fails: {error.strerror}.") from error
