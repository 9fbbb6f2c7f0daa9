"""A client with its pin in a file, against rollback between runs."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import AsyncIterator
from pathlib import Path

from clients.sdk.network_client import NetworkClient
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError

PIN_FILE = "client.pin"


def read_pin(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None


def write_pin_file(path: Path, pin: bytes) -> None:
    """Replace the pin atomically, readable by its owner only."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(pin)
    temporary.replace(path)


@contextlib.asynccontextmanager
async def open_pinned_client(genesis: Genesis, path: Path) -> AsyncIterator[NetworkClient]:
    """Open a client and save its new pin. Raises FILE_UNUSABLE if damaged."""
    pinned = read_pin(path)
    try:
        client = NetworkClient(genesis, pinned=pinned)
    except BlockRobotError as error:
        if pinned is None:
            raise
        sentence = f"{path} is damaged, or of another network ({error.code}); without it the client begins anew."
        raise BlockRobotError("FILE_UNUSABLE", sentence) from None
    async with client:
        try:
            yield client
        finally:
            if client.pinned != pinned:
                write_pin_file(path, client.pinned)
