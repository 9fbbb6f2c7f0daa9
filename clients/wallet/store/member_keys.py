"""A person's four keys, derived from a 24-word mnemonic.

BIP-39, BIP-32, ERC-5564 and HKDF, as in docs/reference/formats.md.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from mnemonic import Mnemonic
from nacl.public import PrivateKey as SealingPrivateKey
from slip10 import SLIP10

from clients.wallet.text_catalogue import refusal
from consensus.primitives.keys import PrivateKey

WORDS_COUNT = 24
_ENTROPY_BYTES = 32
# Purpose 7272 is BlockRobot's own branch; every level is hardened, so that one leaked key leads to no other.
_PATH = "m/7272'/0'/{branch}'"
_SEALING_INFO = b"blockrobot/sealing-key"


@dataclass(frozen=True, slots=True, repr=False)
class WalletKeys:
    """A person's secret keys: M, S, V (secp256k1) and X (X25519, 32 bytes)."""

    identity: PrivateKey
    spend: PrivateKey
    view: PrivateKey
    sealing: bytes

    def __repr__(self) -> str:
        return f"WalletKeys(identity={self.identity.public_key.hex()})"

    @property
    def sealing_public(self) -> bytes:
        return bytes(SealingPrivateKey(self.sealing).public_key)


def draw_words() -> str:
    """24 English words (256 bits, BIP-39)."""
    return str(Mnemonic("english").to_mnemonic(secrets.token_bytes(_ENTROPY_BYTES)))


def derive_keys(words: str) -> WalletKeys:
    """Raises WORDS_INVALID, which gives only word positions."""
    normal = " ".join(words.lower().split())
    language = Mnemonic("english")
    each = normal.split()
    if len(each) != WORDS_COUNT:
        raise refusal("WORDS_INVALID", "words_count", count=len(each))
    unknown = [str(number) for number, word in enumerate(each, start=1) if word not in language.wordlist]
    if unknown:
        raise refusal("WORDS_INVALID", "words_unknown", numbers=", ".join(unknown))
    if not language.check(normal):
        raise refusal("WORDS_INVALID", "words_checksum")
    root = SLIP10.from_seed(language.to_seed(normal), curve_name="secp256k1")
    secrets_by_branch = [root.get_privkey_from_path(_PATH.format(branch=branch)) for branch in range(4)]
    sealing = HKDF(algorithm=hashes.SHA256(), length=32, salt=None, info=_SEALING_INFO).derive(secrets_by_branch[3])
    return WalletKeys(
        identity=PrivateKey(secrets_by_branch[0]),
        spend=PrivateKey(secrets_by_branch[1]),
        view=PrivateKey(secrets_by_branch[2]),
        sealing=sealing,
    )
