"""What a client keeps between runs."""

from __future__ import annotations

from clients.sdk.known_nodes import KnownNodes
from consensus.chain.block import EpochProof
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient
from consensus.primitives.encoding import Wire, decode, encode


class Pin(Wire, frozen=True):
    """The bytes of the newest header that was verified, the epochs that were followed, the nodes that were proved."""

    header_bytes: bytes
    epochs: tuple[EpochProof, ...]
    known: KnownNodes


def write_pin(light_client: LightClient, known: KnownNodes) -> bytes:
    """Return the pin of a client, encoded."""
    return encode(Pin(header_bytes=light_client.pinned_header_bytes, epochs=light_client.epochs, known=known))


def open_pin(genesis: Genesis, pinned: bytes | None) -> tuple[LightClient, KnownNodes | None]:
    """Return a light client at genesis, or where the client was that kept this pin, and the nodes that it knew.

    Raises ENCODING_*, PROOF_INVALID and the like for a pin of another chain.
    """
    if pinned is None:
        return LightClient(genesis), None
    pin = decode(pinned, Pin)
    return LightClient(genesis, pin.header_bytes, pin.epochs), pin.known
