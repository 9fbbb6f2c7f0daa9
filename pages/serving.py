"""Serves a page's own files with strict headers (Content Security Policy Level 3, W3C)."""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from aiohttp import web

from consensus.errors import BlockRobotError

PAGES_ASSETS = Path(__file__).parent / "assets"
ASSET_MAX_BYTES = 1 << 20
ASSETS_MAX_COUNT = 200
_GZIP_LEVEL = 9

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".png": "image/png",
}

SECURITY_HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; media-src blob:; "
        "connect-src 'self'; worker-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), display-capture=()",
}


@dataclass(frozen=True, slots=True)
class Asset:
    """A page's file, plain and gzipped; `etag` is strong (RFC 9110), without quotes."""

    content: bytes
    packed: bytes
    content_type: str
    etag: str


class Assets:
    """A page's files in memory by relative name; the first folder wins. Raises ValueError."""

    def __init__(self, *folders: Path) -> None:
        self._assets: dict[str, Asset] = {}
        for folder in folders:
            for path in sorted(folder.rglob("*")):
                name = path.relative_to(folder).as_posix()
                if path.suffix in _TYPES and path.is_file() and name not in self._assets:
                    self._assets[name] = _read(path)
        if len(self._assets) > ASSETS_MAX_COUNT:
            raise ValueError(f"a page of {len(self._assets)} files")

    def names(self) -> list[str]:
        return list(self._assets)

    def get(self, name: str) -> Asset:
        """Raises ROUTE_UNKNOWN."""
        asset = self._assets.get(name)
        if asset is None:
            raise BlockRobotError("ROUTE_UNKNOWN", "The page has no such file.")
        return asset

    def response(self, name: str, asked: Mapping[str, str] = MappingProxyType({})) -> web.Response:
        """Return a file, or 304 by the request headers `asked`. Raises ROUTE_UNKNOWN."""
        asset = self.get(name)
        is_packed = takes_gzip(asked.get("Accept-Encoding", ""))
        etag = f'"{asset.etag}-gzip"' if is_packed else f'"{asset.etag}"'
        headers = {**SECURITY_HEADERS, "ETag": etag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
        if etag in [tag.strip() for tag in asked.get("If-None-Match", "").split(",")]:
            return web.Response(status=304, headers=headers)
        headers["Content-Type"] = asset.content_type
        if is_packed:
            return web.Response(body=asset.packed, headers=headers | {"Content-Encoding": "gzip"})
        return web.Response(body=asset.content, headers=headers)


def is_client_gone(request: web.BaseRequest, error: BaseException) -> bool:
    """Return whether a request failed because the client closed its connection."""
    return isinstance(error, ConnectionError) and (request.transport is None or request.transport.is_closing())


def takes_gzip(accept_encoding: str) -> bool:
    """Return whether the Accept-Encoding header allows gzip (RFC 9110, 12.5.3)."""
    for each in accept_encoding.lower().split(","):
        coding, _, weight = each.partition(";")
        if coding.strip() == "gzip":
            return weight.strip().removeprefix("q=").strip("0.") != "" or not weight.strip()
    return False


def _read(path: Path) -> Asset:
    content = path.read_bytes()
    if len(content) > ASSET_MAX_BYTES:
        raise ValueError(f"{path.name} has {len(content)} bytes")
    digest = hashlib.sha256(content).hexdigest()[:32]
    packed = gzip.compress(content, _GZIP_LEVEL, mtime=0)
    return Asset(content=content, packed=packed, content_type=_TYPES[path.suffix], etag=digest)
