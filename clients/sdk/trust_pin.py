"""A client's trust kept between runs, against rollback: the pin, and its file."""

from __future__ import annotations

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
