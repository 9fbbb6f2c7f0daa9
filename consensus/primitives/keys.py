"""secp256k1 keys, recoverable low-s signatures (BIP-62, EIP-2) over tagged hashes, and point arithmetic."""

from __future__ import annotations

from btclib_secp256k1 import CData, dsa, ecdh, keys, lib, recovery
from btclib_secp256k1.context import ctx

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import tagged_hash

PUBLIC_KEY_SIZE_BYTES = 33
PRIVATE_KEY_SIZE_BYTES = 32
SIGNATURE_SIZE_BYTES = 65
COMPACT_SIGNATURE_SIZE_BYTES = 64
GROUP_ORDER = 0xFFFFFFFF_FFFFFFFF_FFFFFFFF_FFFFFFFE_BAAEDCE6_AF48A03B_BFD25E8C_D0364141
"""The number of points of secp256k1 (SEC 2, section 2.4.1)."""

_HALF_ORDER = (GROUP_ORDER // 2).to_bytes(32, "big")


class PrivateKey:
    """A secp256k1 private key. Its `repr` never shows the secret."""

    __slots__ = ("_secret", "public_key")

    def __init__(self, secret: bytes) -> None:
        """Take a 32-byte secret. Raises KEY_INVALID outside [1, n-1]."""
        if len(secret) != PRIVATE_KEY_SIZE_BYTES:
            raise BlockRobotError("KEY_INVALID", "A private key has 32 bytes.")
        try:
            self.public_key: bytes = keys.pubkey_from_prvkey(secret)
        except ValueError:
            raise BlockRobotError("KEY_INVALID", "The private key is not a scalar of the curve.") from None
        self._secret = bytes(secret)

    def __repr__(self) -> str:
        return f"PrivateKey(public_key={self.public_key.hex()})"

    @property
    def secret(self) -> bytes:
        return self._secret

    def sign(self, tag: str, *parts: bytes) -> bytes:
        """Return the 65-byte low-s signature (r || s || recovery id), deterministic by RFC 6979."""
        signature, recovery_id = recovery.sign(tagged_hash(tag, *parts), self._secret, verify=False)
        return signature + bytes((recovery_id,))

    def sign_compact(self, tag: str, *parts: bytes) -> bytes:
        return self.sign(tag, *parts)[:COMPACT_SIGNATURE_SIZE_BYTES]

    def shared_point(self, public_key: bytes) -> bytes:
        """Return secret * public_key, 33 bytes (ERC-5564), in constant time. Raises KEY_INVALID."""
        try:
            return ecdh.shared_point(_require_size(public_key), self._secret)
        except ValueError:
            raise BlockRobotError("KEY_INVALID", "A public key is not a point of the curve.") from None


def _require_low_s(signature: bytes) -> None:
    if signature[32:64] > _HALF_ORDER:
        raise BlockRobotError("SIGNATURE_HIGH_S")


def recover(tag: str, signature: bytes, *parts: bytes) -> bytes:
    """Return the signer's 33-byte key. Raises SIGNATURE_INVALID or SIGNATURE_HIGH_S."""
    if len(signature) != SIGNATURE_SIZE_BYTES:
        raise BlockRobotError("SIGNATURE_INVALID", "A recoverable signature has 65 bytes.")
    _require_low_s(signature)
    try:
        return recovery.recover(
            tagged_hash(tag, *parts), signature[:COMPACT_SIGNATURE_SIZE_BYTES], signature[COMPACT_SIGNATURE_SIZE_BYTES]
        )
    except ValueError:
        raise BlockRobotError("SIGNATURE_INVALID") from None


def verify(public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool:
    if len(signature) != COMPACT_SIGNATURE_SIZE_BYTES or signature[32:64] > _HALF_ORDER:
        return False
    try:
        parsed = dsa.parse_compact(signature)
        # Straight to the library: `dsa.verify` takes bytes and would decompress the key again.
        return bool(lib.secp256k1_ecdsa_verify(ctx, parsed, tagged_hash(tag, *parts), _parse_cached(public_key)))
    except ValueError:
        return False


_parsed: dict[bytes, CData] = {}
_PARSED_MAX_COUNT = 1024


def _require_size(public_key: bytes) -> bytes:
    if len(public_key) != PUBLIC_KEY_SIZE_BYTES:
        raise ValueError(f"a public key has {PUBLIC_KEY_SIZE_BYTES} bytes")
    return public_key


def _parse_cached(public_key: bytes) -> CData:
    key = _parsed.get(public_key)
    if key is None:
        if len(_parsed) >= _PARSED_MAX_COUNT:
            _parsed.clear()
        key = _parsed[public_key] = keys.parse(_require_size(public_key))
    return key


def is_public_key(data: bytes) -> bool:
    return len(data) == PUBLIC_KEY_SIZE_BYTES and keys.pubkey_verify(data)


def point_add(first: bytes, second: bytes) -> bytes:
    """Add two compressed points. Raises KEY_INVALID, also for infinity."""
    try:
        return keys.pubkey_combine([_require_size(first), _require_size(second)])
    except ValueError:
        raise BlockRobotError("KEY_INVALID", "A public key is not a point of the curve.") from None


def point_of(scalar: bytes) -> bytes:
    """Return scalar * G, compressed."""
    return PrivateKey(scalar).public_key


def scalar_add(first: bytes, second: bytes) -> bytes:
    """Return (first + second) mod n, 32 bytes. Raises KEY_INVALID for zero."""
    total = (int.from_bytes(first, "big") + int.from_bytes(second, "big")) % GROUP_ORDER
    if total == 0:
        raise BlockRobotError("KEY_INVALID", "The sum of two scalars is zero.")
    return total.to_bytes(32, "big")


def scalar_from_hash(digest: bytes) -> bytes:
    """Reduce a 32-byte hash to [1, n-1]; zero becomes 1."""
    return ((int.from_bytes(digest, "big") % GROUP_ORDER) or 1).to_bytes(32, "big")
