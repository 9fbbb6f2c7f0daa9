"""The prototype's store: plain pictures under owners' marks, for all paper schemes."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

from consensus.errors import BlockRobotError
from consensus.records.renditions import decode_rendition

FILE_NAME = "pictures.sqlite3"


def write_plain_store(folder: Path, pictures: Iterable[tuple[bytes, bytes]]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with closing(sqlite3.connect(folder / FILE_NAME)) as database, database:
        database.execute("CREATE TABLE images (mark BLOB NOT NULL, image BLOB NOT NULL)")
        database.executemany("INSERT INTO images VALUES (?, ?)", list(pictures))


def open_plain_store(folder: Path) -> tuple[int, int]:
    with closing(sqlite3.connect(folder / FILE_NAME)) as database:
        images = [row[0] for row in database.execute("SELECT image FROM images")]
    return len(images), sum(map(_shows, images))


def _shows(image: bytes) -> bool:
    try:
        return bool(decode_rendition(image).pixels)
    except BlockRobotError:
        return False
