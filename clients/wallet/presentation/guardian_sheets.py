"""Printable HTML sheets for guardians, without scripts or loaded resources."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import html
import os
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from clients.wallet.presentation.invocation import WALLET_COMMAND
from clients.wallet.presentation.translations import language_in_use, text
from clients.wallet.recovery.slip39_shares import show_identifier
from clients.wallet.store.keystore import GuardianSet
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from pages.serving import PAGES_ASSETS
from pages.time_format import format_date

SHEET_MAX_BYTES = 256 * 1024
_WORDS_ID = "words"
_SUFFIXES = frozenset({".html", ".htm"})
_STYLE_FILE = Path(__file__).with_name("guardian_sheet.css")
_TO_DO = ("keep", "reach", "check", "help")
_NEVER = ("photo", "type", "tell", "together")


def build_sheet(one: GuardianSet, place: int, share: str) -> str:
    style = (PAGES_ASSETS / "design.css").read_text(encoding="utf-8") + _STYLE_FILE.read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    made = format_date(one.made_at_ms)
    values: dict[str, Any] = {"count": len(one.guardians), "threshold": one.threshold, "name": one.guardians[place]}
    # A sheet names no profile and no folder: these are the owner's.
    values |= {
        "command": WALLET_COMMAND,
        "number": place + 1,
        "identifier": show_identifier(one.identifier),
        "made": made,
    }

    def say(key: str) -> str:
        return html.escape(text(f"sheet.{key}", **values))

    def listed(keys: Sequence[str]) -> str:
        return "<ul>" + "".join(f"<li>{say(key)}</li>" for key in keys) + "</ul>"

    words = "".join(f"<li>{html.escape(word)}</li>" for word in share.split())
    return (
        f'<!doctype html>\n<html lang="{language_in_use()}"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="robots" content="noindex">'
        f"<title>{say('title')}</title><style>{style}</style></head>"
        f'<body><main class="page sheet"><h1>{say("title")}</h1>'
        f'<div class="seal"><div><p>{say("lead")}</p><p><strong>{say("alone")}</strong></p></div></div>'
        f'<section class="card" aria-label="{say("words")}"><ol id="{_WORDS_ID}" translate="no" lang="en">{words}</ol>'
        f"</section><p>{say('which')}</p>"
        f"<h2>{say('to_do')}</h2>{listed(_TO_DO)}<h2>{say('never')}</h2>{listed(_NEVER)}"
        f'<h2>{say("whose")}</h2><p class="quiet">{say("by_hand")}</p><div class="by-hand"></div></main></body></html>\n'
    )


def require_no_sheets(folder: Path) -> None:
    """Raise SHEETS_FOLDER_USED, OSError if unreadable."""
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.suffix.lower() in _SUFFIXES and path.is_file() and _has_words(path):
            raise refusal("SHEETS_FOLDER_USED", "guardian_sheet", folder=str(folder), name=path.name)


def _has_words(path: Path) -> bool:
    with path.open("rb") as file:
        return f'<ol id="{_WORDS_ID}"'.encode() in file.read(SHEET_MAX_BYTES)


def write_sheets(folder: Path, one: GuardianSet, shares: Sequence[str]) -> list[Path]:
    """Write one numbered sheet per guardian, mode 0600, all or none; file names reveal no guardian.

    Raises SHEETS_FOLDER_USED, OSError.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    written: list[Path] = []
    try:
        for place, share in enumerate(shares):
            path = folder / f"{place + 1}.html"
            descriptor = _create(path)
            written.append(path)
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                file.write(build_sheet(one, place, share))
                file.flush()
                os.fsync(file.fileno())
    except BaseException:
        for path in written:
            with contextlib.suppress(OSError):
                path.unlink()
        raise
    return written


def _create(path: Path) -> int:
    try:
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise refusal("SHEETS_FOLDER_USED", "file_there", path=str(path)) from None


class _Words(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []
        self._inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "ol":
            self._inside = ("id", _WORDS_ID) in attrs

    def handle_endtag(self, tag: str) -> None:
        if tag == "ol":
            self._inside = False

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.words.append(data)


def read_written(path: Path) -> str:
    """From a sheet or plain file. Raises SHARE_INVALID, OSError."""
    with path.open("rb") as file:
        data = file.read(SHEET_MAX_BYTES + 1)
    if len(data) > SHEET_MAX_BYTES:
        raise refusal("SHARE_INVALID", "guardian_large", name=path.name)
    return extract_share_text(data.decode("utf-8-sig"))


def extract_share_text(written: str) -> str:
    """Raises SHARE_INVALID."""
    if not written.lstrip().lower().startswith("<!doctype html"):
        return written
    parser = _Words()
    try:
        parser.feed(written)
    except AssertionError:  # html.parser's way to refuse a malformed marked section
        raise BlockRobotError("SHARE_INVALID") from None
    return " ".join(parser.words)
