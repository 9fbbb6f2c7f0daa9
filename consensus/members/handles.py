"""Short handles: 80 bits as bech32m (BIP-350); up to four changed characters are detected."""

from __future__ import annotations

from consensus.errors import BlockRobotError

SHORT_HANDLE_BYTES = 10
PREFIX = "brh"
_LETTERS = "qpzry9x8gf2tvdw0s3jn54khce6mua7l"
_CHECKSUM_CHARS = 6
_DATA_CHARS = SHORT_HANDLE_BYTES * 8 // 5
_GENERATORS = (0x3B6A57B2, 0x26508E6D, 0x1EA119FA, 0x3D4233DD, 0x2A1462B3)
_BECH32M = 0x2BC830A3
_GROUP_CHARS = 4


def _polymod(values: list[int]) -> int:
    check = 1
    for value in values:
        top = check >> 25
        check = (check & 0x1FFFFFF) << 5 ^ value
        for number, generator in enumerate(_GENERATORS):
            check ^= generator if top >> number & 1 else 0
    return check


_EXPANDED = [ord(letter) >> 5 for letter in PREFIX] + [0] + [ord(letter) & 31 for letter in PREFIX]


def encode_short(handle: bytes) -> str:
    bits = int.from_bytes(handle[:SHORT_HANDLE_BYTES])
    values = [bits >> 5 * place & 31 for place in reversed(range(_DATA_CHARS))]
    rest = _polymod(_EXPANDED + values + [0] * _CHECKSUM_CHARS) ^ _BECH32M
    values += [rest >> 5 * place & 31 for place in reversed(range(_CHECKSUM_CHARS))]
    letters = "".join(_LETTERS[value] for value in values)
    groups = [letters[start : start + _GROUP_CHARS] for start in range(0, _DATA_CHARS, _GROUP_CHARS)]
    return "-".join([f"{PREFIX}1", *groups, letters[_DATA_CHARS:]])


def is_short(text: str) -> bool:
    return text.strip().lower().startswith(f"{PREFIX}1")


def decode_short(text: str) -> bytes:
    """Decode a handle's prefix, ignoring case, spaces and dashes. Raises HANDLE_MISTYPED."""
    letters = "".join(text.replace("-", "").split()).lower().removeprefix(f"{PREFIX}1")
    values = [_LETTERS.find(letter) for letter in letters]
    if len(values) != _DATA_CHARS + _CHECKSUM_CHARS or min(values) < 0 or _polymod(_EXPANDED + values) != _BECH32M:
        raise BlockRobotError("HANDLE_MISTYPED")
    bits = 0
    for value in values[:_DATA_CHARS]:
        bits = bits << 5 | value
    return bits.to_bytes(SHORT_HANDLE_BYTES)
