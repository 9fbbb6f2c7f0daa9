"""The explorer's files, in memory, with entity tags and a content security policy."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from aiohttp import web

from pages.serving import PAGES_ASSETS, Assets

EXPLORER_ASSETS = Path(__file__).parent / "assets"
INDEX = "index.html"


@cache
def own_files() -> Assets:
    return Assets(EXPLORER_ASSETS)


@cache
def shared_files() -> Assets:
    return Assets(PAGES_ASSETS)


def answer_own(name: str, asked: Mapping[str, str]) -> web.Response:
    """Raises ROUTE_UNKNOWN."""
    return own_files().response(name or INDEX, asked)


def answer_shared(name: str, asked: Mapping[str, str]) -> web.Response:
    """Raises ROUTE_UNKNOWN."""
    return shared_files().response(name, asked)
