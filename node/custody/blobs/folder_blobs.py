"""Blobs as files of a folder, which its owner's file makes, with mode 0700."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from consensus.errors import BlockRobotError
from node.custody.blobs.blob_store import OWNER_NAME
from node.storage.synced_files import UNFINISHED, sync_directory, write_synced

T = TypeVar("T")
_HEX = "[0-9a-f]" * 2
_BLOB_FOLDER = f"{_HEX}/{_HEX}"


class FolderBlobs:
    """A `BlobStore` on this machine; a name is a file's path below the folder.

    What is not found there is only gone if the owner's file is there; else the disk is.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    async def clear_unfinished(self) -> None:
        def clear() -> None:
            for path in self._folder.glob(f"{_BLOB_FOLDER}/{UNFINISHED}*"):
                path.unlink()

        await self._in_thread(clear)

    async def put(self, name: str, content: bytes) -> None:
        await self._in_thread(lambda: self._write(name, content))

    def _write(self, name: str, content: bytes) -> None:
        path = self._folder / name
        if name == OWNER_NAME:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        else:
            self._require_owner()
            for folder in (path.parent.parent, path.parent):
                if not folder.exists():
                    folder.mkdir(mode=0o700, exist_ok=True)
                    sync_directory(folder.parent)
        write_synced(path, content)

    def _require_owner(self) -> None:
        if not (self._folder / OWNER_NAME).is_file():
            detail = f"The folder of clips {self._folder} has lost its file `{OWNER_NAME}`. Is its disk mounted?"
            raise BlockRobotError("STORE_UNAVAILABLE", detail)

    async def get(self, name: str, max_bytes: int) -> bytes | None:
        def read() -> bytes | None:
            try:
                with (self._folder / name).open("rb") as file:
                    content = file.read(max_bytes + 1)
            except FileNotFoundError:
                if name != OWNER_NAME:
                    self._require_owner()
                return None
            return content if len(content) <= max_bytes else None

        return await self._in_thread(read)

    async def delete(self, name: str) -> None:
        def remove() -> None:
            path = self._folder / name
            try:
                path.unlink()
            except FileNotFoundError:
                self._require_owner()
                return
            sync_directory(path.parent)

        await self._in_thread(remove)

    async def has(self, name: str) -> bool:
        return await self._in_thread((self._folder / name).exists)

    async def names(self, prefix: str = "") -> AsyncIterator[str]:
        walk = os.walk(self._folder / prefix.rpartition("/")[0], onerror=_raise)
        while step := await self._in_thread(lambda: next(walk, None)):
            parent = Path(step[0]).relative_to(self._folder)
            for file in step[2]:
                name = (parent / file).as_posix()
                if name.startswith(prefix) and not file.startswith(UNFINISHED):
                    yield name
        await self._in_thread(self._require_owner)

    async def _in_thread(self, work: Callable[[], T]) -> T:
        try:
            return await asyncio.to_thread(work)
        except OSError as error:
            detail = f"The folder of clips {self._folder} fails: {error.strerror}."
            raise BlockRobotError("STORE_UNAVAILABLE", detail) from error


def _raise(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError):  # no blob has been in that folder
        raise error
