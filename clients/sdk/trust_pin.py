"""A client's trust kept between runs, against rollback: the pin, and its file."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from clients.sdk.known_nodes import KnownNodes
from consensus.chain.block import EpochProof
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient
from consensus.primitives.encoding import Wire, decode, encode

PIN_FILE = "client.pin"


class Pin(Wire, frozen=True):
    """The newest verified header, followed epochs and proved nodes."""

    header_bytes: bytes
    epochs: tuple[EpochProof, ...]
    known: KnownNodes


def write_pin(light_client: LightClient, known: KnownNodes) -> bytes:
    return encode(Pin(header_bytes=light_client.pinned_header_bytes, epochs=light_client.epochs, known=known))


def open_pin(genesis: Genesis, pinned: bytes | None) -> tuple[LightClient, KnownNodes | None]:
    """Raises ENCODING_*, PROOF_INVALID for another chain's."""
    if pinned is None:
        return LightClient(genesis), None
    pin = decode(pinned, Pin)
    return LightClient(genesis, pin.header_bytes, pin.epochs), pin.known


def read_pin(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None


def write_pin_file(path: Path, pin: bytes) -> None:
    """Replace atomically, readable by its owner only."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(pin)
    temporary.replace(path)
