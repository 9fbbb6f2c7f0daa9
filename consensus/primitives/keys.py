"""secp256k1 keys, recoverable signatures and point arithmetic (coincurve). Must never let a signature cross domains.

Every signature is over a tagged hash, so that bytes signed for one purpose say nothing under another. Only the low
form of s is accepted (BIP-62, EIP-2): a signature cannot be rewritten by a stranger into a second valid one.
"""

from __future__ import annotations

from coincurve import PrivateKey as _CurvePrivateKey
from coincurve import PublicKey as _CurvePublicKey
from coincurve.ecdsa import cdata_to_der, deserialize_compact
from coincurve.utils import GROUP_ORDER_INT

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import tagged_hash

PUBLIC_KEY_SIZE_BYTES = 33
PRIVATE_KEY_SIZE_BYTES = 32
SIGNATURE_SIZE_BYTES = 65
COMPACT_SIGNATURE_SIZE_BYTES = 64

_HALF_ORDER = (GROUP_ORDER_INT // 2).to_bytes(32, "big")


class PrivateKey:
    """A secp256k1 private key. Its `repr` never shows the secret."""

    __slots__ = ("_key", "public_key")

    def __init__(self, secret: bytes) -> None:
        """Take a 32-byte secret scalar. Raises KEY_INVALID if it is not in [1, n-1]."""
        if len(secret) != PRIVATE_KEY_SIZE_BYTES:
            raise BlockRobotError("KEY_INVALID", "A private key has 32 bytes.")
        try:
            self._key = _CurvePrivateKey(secret)
        except ValueError:
            raise BlockRobotError("KEY_INVALID", "The private key is not a scalar of the curve.") from None
        self.public_key: bytes = self._key.public_key.format()

    def __repr__(self) -> str:
        return f"PrivateKey(public_key={self.public_key.hex()})"

    @property
    def secret(self) -> bytes:
        """The 32 secret bytes."""
        return bytes(self._key.secret)

    def sign(self, tag: str, *parts: bytes) -> bytes:
        """Return the 65-byte recoverable signature (r || s || recovery id) over tagged_hash(tag, *parts).

        Nonces are deterministic (RFC 6979); libsecp256k1 always makes the low s.
        """
        signature: bytes = self._key.sign_recoverable(tagged_hash(tag, *parts), hasher=None)
        return signature

    def sign_compact(self, tag: str, *parts: bytes) -> bytes:
        """Return the 64-byte signature (r || s) for a verifier who knows the key."""
        return self.sign(tag, *parts)[:COMPACT_SIGNATURE_SIZE_BYTES]

    def shared_point(self, public_key: bytes) -> bytes:
        """Return secret * public_key as 33 compressed bytes (a Diffie-Hellman point, ERC-5564)."""
        return point_multiply(public_key, self.secret)


def _require_low_s(signature: bytes) -> None:
    if signature[32:64] > _HALF_ORDER:
        raise BlockRobotError("SIGNATURE_HIGH_S")


def recover(tag: str, signature: bytes, *parts: bytes) -> bytes:
    """Return the 33-byte public key that made this 65-byte signature over tagged_hash(tag, *parts).

    Raises SIGNATURE_INVALID or SIGNATURE_HIGH_S.
    """
    if len(signature) != SIGNATURE_SIZE_BYTES:
        raise BlockRobotError("SIGNATURE_INVALID", "A recoverable signature has 65 bytes.")
    _require_low_s(signature)
    try:
        key = _CurvePublicKey.from_signature_and_message(signature, tagged_hash(tag, *parts), hasher=None)
    except Exception:  # noqa: BLE001 - coincurve raises bare Exception for a signature without a point
        raise BlockRobotError("SIGNATURE_INVALID") from None
    return bytes(key.format())


def verify(public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool:
    """Tell whether the 64-byte low-s signature over tagged_hash(tag, *parts) was made by `public_key`."""
    if len(signature) != COMPACT_SIGNATURE_SIZE_BYTES or signature[32:64] > _HALF_ORDER:
        return False
    try:
        der = cdata_to_der(deserialize_compact(signature))
        return bool(_parse_cached(public_key).verify(der, tagged_hash(tag, *parts), hasher=None))
    except ValueError:
        return False


_parsed: dict[bytes, _CurvePublicKey] = {}
_PARSED_MAX_COUNT = 1024


def _parse_cached(public_key: bytes) -> _CurvePublicKey:
    """Parse a key once: decompressing costs a square root, and producers sign again and again."""
    key = _parsed.get(public_key)
    if key is None:
        if len(_parsed) >= _PARSED_MAX_COUNT:
            _parsed.clear()
        key = _parsed[public_key] = _CurvePublicKey(public_key)
    return key


def is_public_key(data: bytes) -> bool:
    """Tell whether `data` is a compressed point of the curve (33 bytes)."""
    if len(data) != PUBLIC_KEY_SIZE_BYTES:
        return False
    try:
        _CurvePublicKey(data)
    except ValueError:
        return False
    return True


def point_add(first: bytes, second: bytes) -> bytes:
    """Return the sum of two compressed points. Raises KEY_INVALID if either is none, or the sum is infinity."""
    try:
        return bytes(_CurvePublicKey.combine_keys([_CurvePublicKey(first), _CurvePublicKey(second)]).format())
    except ValueError:
        raise BlockRobotError("KEY_INVALID", "A public key is not a point of the curve.") from None


def point_multiply(point: bytes, scalar: bytes) -> bytes:
    """Return scalar * point, compressed. Raises KEY_INVALID for a bad point or a scalar outside [1, n-1]."""
    try:
        return bytes(_CurvePublicKey(point).multiply(scalar).format())
    except ValueError:
        raise BlockRobotError("KEY_INVALID", "A public key is not a point of the curve.") from None


def point_of(scalar: bytes) -> bytes:
    """Return scalar * G, compressed."""
    return PrivateKey(scalar).public_key


def scalar_add(first: bytes, second: bytes) -> bytes:
    """Return (first + second) mod n as 32 bytes. Raises KEY_INVALID if the sum is zero."""
    total = (int.from_bytes(first, "big") + int.from_bytes(second, "big")) % GROUP_ORDER_INT
    if total == 0:
        raise BlockRobotError("KEY_INVALID", "The sum of two scalars is zero.")
    return total.to_bytes(32, "big")


def scalar_from_hash(digest: bytes) -> bytes:
    """Reduce a 32-byte hash to a scalar in [1, n-1] (zero, which nobody can find, becomes 1)."""
    return ((int.from_bytes(digest, "big") % GROUP_ORDER_INT) or 1).to_bytes(32, "big")
