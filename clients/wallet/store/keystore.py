"""The wallet as one passphrase-sealed file, replaced atomically.

It holds mnemonics, visits (sensitive: they reveal whereabouts) and the newest verified header.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import msgspec

from clients.sdk.new_files import read_given_file, replace_file
from clients.sdk.passphrase import (
    PassphraseCost,
    PassphraseError,
    SealedFileError,
    SealFormat,
    SealingKey,
    new_sealing_key,
    open_sealed,
)
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.rights.right_codes import Correction

_log = logging.getLogger(__name__)

_FORMAT = SealFormat(b"BRWALLET1", "blockrobot/wallet-file")
WALLET_FILE_MAX_BYTES = 64 * 1024 * 1024


class GivenGrant(msgspec.Struct):
    """A grant by this wallet: grantee handle (32 bytes), label, visit and salt opening the chain's hash."""

    grant_id: bytes
    owner: bytes
    handle: bytes
    label: str
    salt: bytes


class SharedCopy(msgspec.Struct):
    """Pictures of a shared record written into a local folder."""

    record_id: bytes
    folder: str


class ReceivedGrant(msgspec.Struct):
    """A grant for this wallet, with key derivation data and written copies.

    `era` numbers the mnemonics from the first; `confirmed` holds `<record id>:<kind>` notices confirmed to the owner.
    """

    grant_id: bytes
    owner: bytes
    ephemeral: bytes
    era: int = 0
    copies: list[SharedCopy] = msgspec.field(default_factory=list)
    confirmed: list[str] = msgspec.field(default_factory=list)


class GuardianSet(msgspec.Struct):
    """One set of guardian shares, with the identifier that all bear.

    `era` numbers the wallet's mnemonics from its first; `handed_count` guardians had received theirs at the end.
    """

    made_at_ms: int
    threshold: int
    guardians: list[str]
    identifier: int
    era: int
    handed_count: int = 0

    @property
    def is_whole(self) -> bool:
        return self.handed_count == len(self.guardians)


class KnownVisit(msgspec.Struct):
    """One of the wallet's own visits, with what derives its owner key.

    `owner`: first key, the visit's name; `current`: deciding key after transfer; `ephemeral` and `era` (mnemonic
    number) belong to the deciding key. `taken`: foreign key decides; `stuck`: not transferable; `shares_due`: unknown
    shares may survive transfer.
    """

    owner: bytes
    ephemeral: bytes
    robot: bytes
    sequence: int
    bucket_ms: int
    current: bytes = b""
    era: int = 0
    taken: bool = False
    stuck: bool = False
    shares_due: bool = False


class WalletContent(msgspec.Struct):
    """The decrypted wallet file.

    `cost_chosen`: who made it chose what a passphrase guess costs; else a resealed file costs today's default at least.
    `former`: replaced mnemonics, oldest first, needed for decryption. `next_words`: kept before signing with it.
    `leaving`: leave transactions; `left`: one provably succeeded. `proofs`: by txid.
    """

    words: str
    handle: bytes = b""
    role: str = ""
    visits: list[KnownVisit] = msgspec.field(default_factory=list)
    scanned_count: int = 0
    pin: bytes = b""
    asked_erasures: list[bytes] = msgspec.field(default_factory=list)
    corrections: list[Correction] = msgspec.field(default_factory=list)
    given_grants: list[GivenGrant] = msgspec.field(default_factory=list)
    received_grants: list[ReceivedGrant] = msgspec.field(default_factory=list)
    scanned_grants_count: int = 0
    receipts: list[bytes] = msgspec.field(default_factory=list)
    receipts_due: list[bytes] = msgspec.field(default_factory=list)
    notice_shown_version: int = 0
    notice_consented_version: int = 0
    former: list[str] = msgspec.field(default_factory=list)
    next_words: str = ""
    next_words_shown: bool = False
    transfers_due: bool = False
    left: bool = False
    leaving: list[bytes] = msgspec.field(default_factory=list)
    guardian_sets: list[GuardianSet] = msgspec.field(default_factory=list)
    proofs: dict[bytes, bytes] = msgspec.field(default_factory=dict)
    proofs_dropped_count: int = 0
    cost_chosen: bool = False

    def __repr__(self) -> str:
        return f"WalletContent({len(self.visits)} visits)"


def _damaged(error: SealedFileError, path: Path) -> BlockRobotError:
    if str(error) == "changed":
        return refusal("WALLET_DAMAGED", "wallet_changed", path=str(path))
    if str(error) == "work":
        return refusal("WALLET_DAMAGED", "wallet_work", path=str(path))
    return refusal("WALLET_DAMAGED", "wallet_no_file", path=str(path))


class Keystore:
    """An open wallet file; `save` seals with a fresh nonce."""

    def __init__(self, path: Path, key: SealingKey, content: WalletContent) -> None:
        self._path = path
        self._key = key
        self._passphrase: str | None = None  # for a dearer key, due at the next save
        self._is_read_only = False
        self.content = content

    def __repr__(self) -> str:
        return f"Keystore({self._path})"

    @classmethod
    def create(
        cls, path: Path, words: str, passphrase: str, cost: PassphraseCost | None = None, *, former: Sequence[str] = ()
    ) -> Keystore:
        """Mode 0600; `former` is oldest first. Raises WALLET_EXISTS."""
        if path.exists():
            raise refusal("WALLET_EXISTS", "wallet_exists", path=str(path))
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        content = WalletContent(words=words, former=list(former), cost_chosen=cost is not None)
        store = cls(path, new_sealing_key(passphrase, _FORMAT, cost), content)
        store.save()
        return store

    @classmethod
    def open(cls, path: Path, passphrase: str) -> Keystore:
        """Raises WALLET_NOT_FOUND, WALLET_DAMAGED or WALLET_PASSPHRASE_WRONG."""
        try:
            data = read_given_file(path, WALLET_FILE_MAX_BYTES)
        except FileNotFoundError:
            raise refusal("WALLET_NOT_FOUND", "wallet_not_found", path=str(path)) from None
        except BlockRobotError:
            raise refusal("WALLET_DAMAGED", "wallet_large", path=str(path)) from None
        try:
            plain, key = open_sealed(data, passphrase, _FORMAT)
        except SealedFileError as error:
            raise _damaged(error, path) from None
        except PassphraseError:
            raise BlockRobotError("WALLET_PASSPHRASE_WRONG") from None
        try:
            content = msgspec.msgpack.decode(plain, type=WalletContent)
        except msgspec.MsgspecError:
            raise refusal("WALLET_DAMAGED", "wallet_version", path=str(path)) from None
        store = cls(path, key, content)
        if not content.cost_chosen and key.is_cheap:
            store._passphrase = passphrase
        return store

    def opens_with(self, passphrase: str) -> bool:
        """Costs as much as opening."""
        return self._key.is_from(passphrase)

    def read_only(self) -> None:
        """Write nothing from now on: another program holds the file."""
        self._is_read_only = True

    def save(self) -> None:
        """Replace the file atomically; if read-only, only log."""
        if self._is_read_only:
            _log.info("The wallet is read beside another program: what was to be noted in it is dropped.")
            return
        if self._passphrase is not None:
            self._key, self._passphrase = new_sealing_key(self._passphrase, _FORMAT), None
        replace_file(self._path, self._key.seal(msgspec.msgpack.encode(self.content)))
