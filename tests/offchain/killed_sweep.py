"""Fill a store, erase of it, and be gone in the middle of the sweep: `killed_sweep.py FOLDER POINT`.

Writes, before it goes, pieces of what was erased, in hex.
"""

from __future__ import annotations

import asyncio
import os
import sqlite3
import sys
from pathlib import Path
from typing import Any

import node.custody.stores.sqlite_sweep as sweeping
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.stored_clips import make_clip, pieces_of


def die(*_arguments: Any) -> Any:
    sys.stdout.flush()
    os._exit(9)


def cut_off(point: str) -> None:
    """Let the process end before the log is copied, before the pages are cleaned, before the log is cut, or after."""
    checkpoint = sweeping._checkpoint

    def checkpointing(database: sqlite3.Connection, mode: str) -> None:
        if (mode, point) in {("FULL", "before"), ("TRUNCATE", "cleaned")}:
            die()
        checkpoint(database, mode)
        if (mode, point) in {("FULL", "copied"), ("TRUNCATE", "cut")}:
            die()

    sweeping._checkpoint = checkpointing


async def main(folder: Path, point: str) -> None:
    async with SqliteStore(folder) as store:
        clips = [make_clip(number, 1_500) for number in range(40)]
        for clip, frames in clips:
            await store.stage(clip, frames)
        await store.sweep()
        for clip, frames in clips[::2]:
            await store.erase_clips([clip.record_id])
            sys.stdout.write("\n".join([*(piece.hex() for piece in pieces_of(clip, frames)), ""]))
        cut_off(point)
        await store.sweep()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), sys.argv[2]))
