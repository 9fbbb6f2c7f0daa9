"""The prototype's store, for comparison: pictures in the clear under their owner's mark.

Peppering or salting the mark changes nothing of the pictures, so one store stands for all the paper's schemes.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

from consensus.errors import BlockRobotError
from consensus.records.renditions import decode_rendition

FILE_NAME = "pictures.sqlite3"


def write_plain_store(folder: Path, pictures: Iterable[tuple[bytes, bytes]]) -> None:
    """Write (mark, picture) rows."""
    folder.mkdir(parents=True, exist_ok=True)
    with closing(sqlite3.connect(folder / FILE_NAME)) as database, database:
        database.execute("CREATE TABLE images (mark BLOB NOT NULL, image BLOB NOT NULL)")
        database.executemany("INSERT INTO images VALUES (?, ?)", list(pictures))


def open_plain_store(folder: Path) -> tuple[int, int]:
    """Return how many rows a thief finds, and how many of them show a picture."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as database:
        images = [row[0] for row in database.execute("SELECT image FROM images")]
    return len(images), sum(map(_shows, images))


def _shows(image: bytes) -> bool:
    try:
        return bool(decode_rendition(image).pixels)
    except BlockRobotError:
        return False
