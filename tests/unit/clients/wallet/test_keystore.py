"""The wallet's file: encrypted, whole or not at all, readable by its user only."""

from __future__ import annotations

import os
import stat
import unicodedata
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from nacl import pwhash

from clients.sdk import passphrase
from clients.sdk.passphrase import PassphraseCost, new_sealing_key
from clients.wallet.store import keystore
from clients.wallet.store.keystore import Keystore, KnownVisit, WalletContent
from consensus.errors import BlockRobotError

WORDS = "abandon " * 23 + "art"
CHEAP = PassphraseCost(pwhash.argon2id.OPSLIMIT_MIN, pwhash.argon2id.MEMLIMIT_MIN)
VISIT = KnownVisit(owner=b"O" * 33, ephemeral=b"R" * 33, robot=b"M" * 33, sequence=4, bucket_ms=300_000)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "wallets" / "ann.wallet"


def code_of(path: Path, passphrase: str = "tea") -> str:
    with pytest.raises(BlockRobotError) as caught:
        Keystore.open(path, passphrase)
    return caught.value.code


def test_what_was_saved_is_found_again(path: Path) -> None:
    store = Keystore.create(path, WORDS, "tea", CHEAP)
    store.content.visits.append(VISIT)
    store.content.pin = b"header"
    store.save()
    again = Keystore.open(path, "tea").content
    assert (again.words, again.visits, again.pin) == (WORDS, [VISIT], b"header")


def test_a_wrong_passphrase_is_said_to_be_wrong(path: Path) -> None:
    Keystore.create(path, WORDS, "tea", CHEAP)
    assert code_of(path, "coffee") == "WALLET_PASSPHRASE_WRONG"


COMPOSED, DECOMPOSED = (unicodedata.normalize(form, "ameixa cação jardim avó") for form in ("NFC", "NFD"))


@pytest.mark.parametrize(("made", "asked"), [(COMPOSED, DECOMPOSED), (DECOMPOSED, COMPOSED), (DECOMPOSED, DECOMPOSED)])
def test_a_passphrase_is_the_same_however_its_accents_are_encoded(path: Path, made: str, asked: str) -> None:
    Keystore.create(path, WORDS, made, CHEAP)
    store = Keystore.open(path, asked)
    assert store.content.words == WORDS
    assert store.opens_with(made)
    assert store.opens_with(asked)
    assert not store.opens_with("ameixa cacao jardim avo")


def test_the_file_is_for_its_user_only(path: Path) -> None:
    store = Keystore.create(path, WORDS, "tea", CHEAP)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    store.save()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_neither_words_nor_visits_stand_in_the_file(path: Path) -> None:
    store = Keystore.create(path, WORDS, "tea", CHEAP)
    store.content.visits.append(VISIT)
    store.save()
    data = path.read_bytes()
    assert b"abandon" not in data
    assert VISIT.owner not in data


def test_each_saving_seals_anew(path: Path) -> None:
    store = Keystore.create(path, WORDS, "tea", CHEAP)
    first = path.read_bytes()
    store.save()
    assert path.read_bytes() != first


def test_a_wallet_is_never_overwritten_by_a_new_one(path: Path) -> None:
    Keystore.create(path, WORDS, "tea", CHEAP)
    before = path.read_bytes()
    with pytest.raises(BlockRobotError, match=r"^WALLET_EXISTS:"):
        Keystore.create(path, WORDS, "other", CHEAP)
    assert path.read_bytes() == before


def test_where_there_is_none_none_is_opened(path: Path) -> None:
    assert code_of(path) == "WALLET_NOT_FOUND"


def test_every_shortened_file_is_called_damaged(path: Path) -> None:
    Keystore.create(path, WORDS, "tea", CHEAP)
    data = path.read_bytes()
    for length in range(len(data)):
        path.write_bytes(data[:length])
        assert code_of(path) == "WALLET_DAMAGED", length


def test_every_flipped_byte_is_called_damage_and_not_a_wrong_passphrase(path: Path) -> None:
    """Whoever types the right passphrase must not be told that it is wrong; and a changed cost must not be paid."""
    Keystore.create(path, WORDS, "tea", CHEAP)
    data = path.read_bytes()
    for place in range(len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x81]) + data[place + 1 :])
        assert code_of(path) == "WALLET_DAMAGED", place


@pytest.mark.parametrize("weaker", [{"operations_count": 1}, {"memory_bytes": pwhash.argon2id.MEMLIMIT_MIN}])
def test_a_file_sealed_at_less_than_todays_cost_is_resealed_at_todays(
    path: Path, monkeypatch: pytest.MonkeyPatch, weaker: dict[str, int]
) -> None:
    today = PassphraseCost(2, 2 * pwhash.argon2id.MEMLIMIT_MIN)
    monkeypatch.setattr(passphrase, "PassphraseCost", lambda *given: PassphraseCost(*given) if given else today)
    path.parent.mkdir()
    old = new_sealing_key("tea", keystore._FORMAT, replace(today, **weaker))
    path.write_bytes(old.seal(msgspec.msgpack.encode(WalletContent(words=WORDS))))
    store = Keystore.open(path, "tea")
    assert path.read_bytes().count(old.header) == 1, "reading writes nothing"
    store.save()
    assert passphrase._read_header(store._key.header, keystore._FORMAT)[1] == today
    again = Keystore.open(path, "tea")
    again.save()
    assert again._key.header == store._key.header, "it is raised once"
    assert again.content.words == WORDS
    assert code_of(path, "coffee") == "WALLET_PASSPHRASE_WRONG"


def test_a_cost_that_was_chosen_stays(path: Path) -> None:
    """As for a demonstration: no command of it shall take a second."""
    header = Keystore.create(path, WORDS, "tea", CHEAP)._key.header
    store = Keystore.open(path, "tea")
    store.save()
    assert store._key.header == header


def test_a_file_that_asks_for_absurd_work_is_refused_unopened(path: Path) -> None:
    """A forged file with a right checksum must not hang the machine."""
    forged = Keystore.create(path, WORDS, "tea", CHEAP)
    dear = [b"s" * pwhash.argon2id.SALTBYTES, 2**31, 2**40]
    forged._key = replace(forged._key, header=b"BRWALLET1" + msgspec.msgpack.encode(dear))
    forged.save()
    assert code_of(path) == "WALLET_DAMAGED"


def test_a_crash_before_the_new_file_is_in_place_leaves_the_old_one(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Keystore.create(path, WORDS, "tea", CHEAP)
    before = path.read_bytes()

    def crash(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", crash)
    store.content.handle = b"h" * 32
    with pytest.raises(OSError, match="No space"):
        store.save()
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    assert Keystore.open(path, "tea").content.handle == b""


def test_no_secret_shows_when_a_wallet_is_printed(path: Path) -> None:
    store = Keystore.create(path, WORDS, "tea", CHEAP)
    store.content.visits.append(VISIT)
    for shown in (repr(store), str(store), repr(store.content), str(store.content)):
        assert "abandon" not in shown
        assert repr(VISIT.owner) not in shown
        assert "tea" not in shown.replace("Keystore", "")
