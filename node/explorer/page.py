"""The explorer's files, in memory, with strict headers.

What a page shows comes from the node's routes, which let in whom their rules name. The file `pages/serving.py` reads all
files once, and answers with an entity tag and a content security policy.
"""

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
    """Return the explorer's own files."""
    return Assets(EXPLORER_ASSETS)


@cache
def shared_files() -> Assets:
    """Return the files that all pages share."""
    return Assets(PAGES_ASSETS)


def answer_own(name: str, asked: Mapping[str, str]) -> web.Response:
    """Return a file of the explorer, or 304 if the browser has it. Raises ROUTE_UNKNOWN."""
    return own_files().response(name or INDEX, asked)


def answer_shared(name: str, asked: Mapping[str, str]) -> web.Response:
    """Return a file that all pages share, or 304 if the browser has it. Raises ROUTE_UNKNOWN."""
    return shared_files().response(name, asked)
