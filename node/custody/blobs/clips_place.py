"""Where a custodian's ciphertexts lie, if not in its store: `folder:PATH` or `s3://BUCKET/PREFIX`."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import msgspec

from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from node.custody.blobs.blob_names import KEY_BYTES, BlobNames
from node.storage.synced_files import write_synced
from pages.listening import is_loopback

REGION_DEFAULT = "us-east-1"
PLACE_FILE_NAME = "clips.json"
PLACE_FILE_MAX_BYTES = 4096
FOLDER_DEFAULT_NAME = "clips"


@dataclass(frozen=True, slots=True)
class ClipsPlace:
    """A folder, or a bucket and prefix at an S3 endpoint (empty: AWS).

    `credentials_path`: a file as the AWS tools read it; None: what the environment gives them.
    """

    url: str
    folder: Path | None = None
    bucket: str = ""
    prefix: str = ""
    endpoint: str = ""
    region: str = REGION_DEFAULT
    ca_path: Path | None = None
    credentials_path: Path | None = None


class PlaceFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`custody/clips.json`: where the clips that the index refers to are, and the key of their names (hex)."""

    url: str
    names_key: str


def _invalid(detail: str) -> BlockRobotError:
    return BlockRobotError("CONFIGURATION_INVALID", f"[custody] clips: {detail}")


def read_place(
    url: str,
    data_dir: Path,
    *,
    endpoint: str = "",
    region: str = REGION_DEFAULT,
    ca_path: Path | None = None,
    credentials_path: Path | None = None,
) -> ClipsPlace:
    """Raises CONFIGURATION_INVALID."""
    scheme, _, rest = url.partition(":")
    if scheme == "folder":
        return ClipsPlace(url, folder=data_dir / (rest or FOLDER_DEFAULT_NAME))
    parts, where = urlsplit(url), urlsplit(endpoint)
    if scheme != "s3" or not parts.netloc or "@" in parts.netloc or parts.query or parts.fragment:
        raise _invalid("it is folder, folder:PATH or s3://BUCKET/PREFIX, without keys.")
    if endpoint and (where.scheme not in ("http", "https") or not where.hostname or where.username or where.query):
        raise _invalid("clips_endpoint is a URL as https://HOST:PORT, without keys.")
    if where.scheme == "http" and not is_loopback(where.hostname or ""):
        raise _invalid("an endpoint on another machine needs https.")
    prefix = parts.path.strip("/")
    return ClipsPlace(
        url, None, parts.netloc, f"{prefix}/" if prefix else "", endpoint, region, ca_path, credentials_path
    )


def require_place(custody_dir: Path, place: ClipsPlace | None) -> None:
    """Raise CONFIGURATION_INVALID if the index refers to clips that are somewhere else."""
    known = read_place_file(custody_dir)
    url = "" if place is None else place.url
    if known is not None and known.url != url:
        detail = f"the clips of this custodian are in {known.url}. Name that, or move them by `node move-custody`."
        raise _invalid(detail)


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
        raise _invalid(f"{path} is damaged; take it from a backup of this node.") from error


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
        raise _invalid(f"{PLACE_FILE_NAME} is damaged; take it from a backup of this node.") from error
    except OSError as error:
        raise BlockRobotError("STORE_UNAVAILABLE", f"{custody_dir} fails: {error.strerror}.") from error
