"""Finds files of earlier views that the latest one did not rewrite."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from itertools import groupby
from pathlib import Path

from clients.sdk.pictures.picture_names import is_picture_name
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import console
from clients.wallet.presentation.translations import text
from clients.wallet.records.album import ANIMATION_NAME, SHEET_NAME, visit_prefix

FOLDERS_NAMED_MAX_COUNT = 5
FILES_NAMED_MAX_COUNT = 4
_SHEETS = frozenset({SHEET_NAME, ANIMATION_NAME})
_RECORD = re.compile(r"[0-9a-f]{32}")
_OF_VISIT = re.compile(rf"visit-[0-9a-f]{{12}}-(?:{re.escape(SHEET_NAME)}|{re.escape(ANIMATION_NAME)})")


def find_earlier_of(
    out: Path, written: Collection[Path], records: Iterable[bytes], visits: Iterable[bytes] = ()
) -> list[Path]:
    found = [path for record_id in records for path in _of_record(out / record_id.hex())]
    sheets = [out / f"{visit_prefix(owner)}{name}" for owner in visits for name in sorted(_SHEETS)]
    return [path for path in (*found, *sheets) if path.is_file() and path not in written]


def find_earlier(out: Path, written: Collection[Path]) -> list[Path]:
    if not out.is_dir():
        return []
    there = sorted(out.iterdir())
    found = [path for folder in there if _RECORD.fullmatch(folder.name) for path in _of_record(folder)]
    found += [path for path in there if _OF_VISIT.fullmatch(path.name)]
    return [path for path in found if path.is_file() and path not in written]


def _of_record(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return [path for path in sorted(folder.iterdir()) if is_picture_name(path.name) or path.name in _SHEETS]


def print_earlier_files(files: Collection[Path]) -> None:
    if not files:
        return
    folders = [(folder, [path.name for path in group]) for folder, group in groupby(files, lambda path: path.parent)]
    for folder, names in folders[:FOLDERS_NAMED_MAX_COUNT]:
        listed = ", ".join(names[:FILES_NAMED_MAX_COUNT]) + (", ..." if len(names) > FILES_NAMED_MAX_COUNT else "")
        console.print(escape(text("earlier.files", count=len(names), folder=folder, names=listed)))
    others = folders[FOLDERS_NAMED_MAX_COUNT:]
    if others:
        folders_told = text("count.folders", count=len(others))
        console.print(text("earlier.more", count=sum(len(names) for _, names in others), folders=folders_told))
    console.print(text("earlier.next"))
