"""Where a custodian's ciphertexts lie, if not in its store: `folder:PATH` or `s3://BUCKET/PREFIX`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from consensus.errors import BlockRobotError
from pages.listening import is_loopback

REGION_DEFAULT = "us-east-1"
FOLDER_DEFAULT_NAME = "clips"


@dataclass(frozen=True, slots=True)
class ClipsPlace:
    """A folder, or a bucket and prefix at an S3 endpoint (empty: AWS).

    `credentials_path`: a file with the two keys; None: what the environment gives the AWS library.
    """

    url: str
    folder: Path | None = None
    bucket: str = ""
    prefix: str = ""
    endpoint: str = ""
    region: str = REGION_DEFAULT
    ca_path: Path | None = None
    credentials_path: Path | None = None


def invalid_place(detail: str) -> BlockRobotError:
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
    try:
        parts, where = urlsplit(url), urlsplit(endpoint)
    except ValueError as error:
        raise invalid_place(f"no URL: {error}.") from None
    if scheme != "s3" or not parts.netloc or "@" in parts.netloc or parts.query or parts.fragment:
        raise invalid_place("it is folder, folder:PATH or s3://BUCKET/PREFIX, without keys.")
    if endpoint and (where.scheme not in ("http", "https") or not where.hostname or where.username or where.query):
        raise invalid_place("clips_endpoint is a URL as https://HOST:PORT, without keys.")
    if where.scheme == "http" and not is_loopback(where.hostname or ""):
        raise invalid_place("an endpoint on another machine needs https.")
    prefix = parts.path.strip("/")
    return ClipsPlace(
        url, None, parts.netloc, f"{prefix}/" if prefix else "", endpoint, region, ca_path, credentials_path
    )
