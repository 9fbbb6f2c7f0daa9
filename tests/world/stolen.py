"""A wallet on a chain with the contracts that ship: sessions and standing are the node's own, only the network is left out.

Power can be cut before and after every saving and every call.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from clients.sdk.chain.announcements import Announcement, AnnouncementPage
from clients.sdk.proof_checks import ProvedState
from clients.wallet.cli import wallet_context
from clients.wallet.cli.main import wallet
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.recovery.key_rotation import KeyRotation
from clients.wallet.store.keystore import Keystore, KnownVisit
from clients.wallet.store.member_keys import derive_keys
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, encode
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import seal_metadata
from consensus.records.metadata import RecordMetadata, compute_metadata_hash
from consensus.state.identity import active_role
from consensus.state.records import decided_root
from contracts.execution.sender_admission import is_admitted
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Visit, key_of
from tests.world.dicts import CHEAP
from tests.world.ward import Patient

OLD_WORDS = " ".join(["abandon"] * 23 + ["art"])


class PowerCut(BaseException):
    """The device is off."""


class Power:
    """Counts the moments at which power could be cut, and cuts it at one of them."""

    def __init__(self) -> None:
        self.moments, self.cut_at = 0, -1

    def moment(self) -> None:
        self.moments += 1
        if self.moments - 1 == self.cut_at:
            raise PowerCut


@dataclass(frozen=True)
class Final:
    """What a wallet looks at of a final receipt."""

    txid: bytes
    height: int
    ok: bool = True
    code: str = ""
    evidence: None = None
    transaction: None = None

    def require_ok(self) -> Final:
        if not self.ok:
            raise BlockRobotError("CALL_REFUSED", self.code, contract_code=self.code)
        return self


class Chain:
    """What the network client does for a wallet, on the hospital's state. A session is given by the node's own rule."""

    pinned = b""

    def __init__(self, hospital: Hospital, power: Power) -> None:
        self.hospital, self.power = hospital, power
        self.calls: list[tuple[bytes, str]] = []
        self.finals: dict[bytes, Final] = {}
        self.troubles: dict[str, BlockRobotError] = {}

    async def close(self) -> None:
        """Nothing is open."""

    def _open_session(self, key: PrivateKey, *, member: bool = False) -> None:
        role = active_role(self.hospital.state, key.public_key)
        if not role and (member or decided_root(self.hospital.state, key.public_key) is None):
            raise BlockRobotError("SESSION_REFUSED")

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        self._open_session(key)
        found = {flat: self.hospital.state.get(flat) for flat in keys}
        values = {flat: None if data is None else decode_value(data) for flat, data in found.items()}
        return ProvedState(height=self.hospital.height, timestamp_ms=self.hospital.time_ms, values=values)

    async def announcements(self, first: int, key: PrivateKey) -> AnnouncementPage:
        self._open_session(key, member=True)
        count = self.hospital.value("records", b"announcement-count") or 0
        items = [
            Announcement(first + place, *parts)
            for place, parts in enumerate(self.hospital.view("records", "announcements", first, 2))
        ]
        return AnnouncementPage(count, tuple(items), first + len(items))

    @property
    def transactions(self) -> Chain:
        """Who builds transactions."""
        return self

    def build(self, key: PrivateKey, contract: str, entry: str, arguments: list[Any]) -> Transaction:
        return self.hospital.sign(key, contract, entry, *arguments)

    async def submit_and_wait(self, transaction: Transaction) -> Final:
        self.power.moment()
        if not is_admitted(self.hospital.state, transaction, self.hospital.time_ms):
            raise BlockRobotError("SENDER_NOT_ADMITTED")
        self.calls.append((transaction.body.sender, transaction.body.entry))
        (receipt,) = self.hospital.block([transaction])
        final = Final(receipt.txid, self.hospital.height, receipt.ok, receipt.code)
        self.finals[receipt.txid] = final
        if receipt.ok:
            self.power.moment()
        return final

    async def wait_final(self, txid: bytes, _timeout_ms: int, *, lane: bytes) -> Final:
        """Anybody may ask, without a session."""
        if txid not in self.finals:
            raise BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME")
        return self.finals[txid]

    async def call(self, key: PrivateKey, contract: str, entry: str, arguments: list[Any]) -> Final:
        return (await self.submit_and_wait(self.build(key, contract, entry, arguments))).require_ok()


class CutStore(Keystore):
    """A wallet file whose device may be switched off before and after each writing."""

    power: Power

    def save(self) -> None:
        self.power.moment()
        super().save()
        self.power.moment()


class Story:
    """A hospital, and a wallet that is opened again after each cut."""

    def __init__(self, folder: Path, words: str) -> None:
        self.hospital, self.power = Hospital(), Power()
        self._hashes: dict[bytes, bytes] = {}
        self.path, self.words = folder / "ann.wallet", words
        Keystore.create(self.path, words, "tea and lemon cake", CHEAP)
        self.chain = Chain(self.hospital, self.power)
        self.person = Patient("ann", keys=derive_keys(words))
        card = self.hospital.card("ann")
        arguments = self.hospital.register_arguments(self.person, card)
        self.hospital.must(self.person.identity, "identity", "register", *arguments)
        self.handle = card.handle

    def open(self, path: Path | None = None) -> Wallet:
        """Open the wallet as a device does that was just switched on."""
        store = Keystore.open(path or self.path, "tea and lemon cake")
        store.__class__ = CutStore
        store.power = self.power  # type: ignore[attr-defined]
        opened = Wallet(store, self.hospital.genesis)
        opened.network = self.chain  # type: ignore[assignment]
        return opened

    def copy(self, name: str, words: str, former: list[str]) -> Wallet:
        """Make another wallet from words, as a thief does, or she herself on another device."""
        path = self.path.with_name(f"{name}.wallet")
        store = Keystore.create(path, words, "tea and lemon cake", CHEAP)
        store.content.former = former
        store.save()
        return self.open(path)

    def visit(self, number: int, records: int = 2, person: Patient | None = None) -> Visit:
        """Record somebody (her, unless another is named): a visit with records whose metadata are sealed to the keys."""
        who = person or self.person
        visit = self.hospital.open_visit(who, number)
        for index in range(records):
            self.record(visit, who, index)
        return visit

    def record(self, visit: Visit, who: Patient, index: int) -> bytes:
        """Record one clip of a visit."""
        now_ms = self.hospital.time_ms
        previous = self._hashes.get(visit.owner, bytes(32))
        metadata = RecordMetadata("depth", now_ms, now_ms + 500, 5, index, previous, (), 640, 480)
        self._hashes[visit.owner] = compute_metadata_hash(metadata)
        return self.hospital.record(visit, sealed_metadata=seal_metadata(who.sealing, encode(metadata)))

    def current(self, visit: Visit | KnownVisit) -> bytes:
        """Return the key that decides of a visit on the chain."""
        return bytes(self.hospital.view("records", "current_of", visit.owner))


def give_grant(story: Story, key: PrivateKey, visit: KnownVisit | Visit, name: str) -> bytes:
    """Share a record of a visit by its key, as whoever has the words can."""
    record_id = bytes(story.hospital.view("records", "of_visit", visit.owner)[0])
    keys = key_of(name).public_key, key_of(f"{name}'s ephemeral").public_key
    arguments = [[record_id], *keys, 1, bytes(32), "research", story.hospital.bucket() + DAY_MS]
    return story.hospital.must(key, "access", "grant", *arguments).txid


async def no_pause(_: float) -> None:
    """Chance decides how long; here nobody waits."""


async def take_new_words(wallet: Wallet, sleep: Callable[[float], Awaitable[None]] = no_pause) -> KeyRotation:
    """Do what `wallet rotate` does up to the new member key, and move no visit yet."""
    rotating = KeyRotation(wallet, sleep=sleep)
    rotating.prepare()
    rotating.confirm_shown()
    assert await rotating.rotate()
    return rotating


class WalletHarness:
    """A person at her device: commands run on the story's wallet and chain."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.story = Story(folder, OLD_WORDS)
        self.story.visit(1)
        self.folder = folder
        self.words_file = folder / "new.txt"
        passphrase = folder / "passphrase"
        passphrase.write_text("tea and lemon cake\n")
        monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(passphrase))
        monkeypatch.setattr(wallet_context, "load_genesis", lambda _: self.story.hospital.genesis)
        monkeypatch.setattr(wallet_context, "Wallet", self._open)

    def _open(self, store: Keystore, genesis: Any) -> Wallet:
        opened = Wallet(store, genesis)
        opened.network = self.story.chain  # type: ignore[assignment]
        return opened

    def run(self, *arguments: str, profile: str = "ann", keyboard: str | None = None) -> Result:
        group = ["--wallet-dir", str(self.folder), "--profile", profile]
        return CliRunner().invoke(wallet, [*group, *arguments], input=keyboard)

    @property
    def command(self) -> str:
        """How her wallet is called here."""
        return f"blockrobot wallet --profile ann --wallet-dir {self.folder}"

    def rotate(self, *arguments: str) -> Result:
        return self.run("rotate", "--words-file", str(self.words_file), "--yes", "--now", *arguments)
