"""The passphrase in the system's keyring: only where it was asked for, and refused with a next step where there is none."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest
from click.testing import CliRunner, Result

from clients.wallet import opening
from clients.wallet.cli import wallet
from clients.wallet.keystore import Keystore
from consensus.errors import BlockRobotError
from tests.unit.clients.wallet.conftest import CHEAP

WORDS = " ".join(["abandon"] * 23 + ["art"])


class Ring(ModuleType):
    """A keyring in memory."""

    def __init__(self) -> None:
        super().__init__("keyring")
        self.held: dict[tuple[str, str], str] = {}
        self.errors = ModuleType("keyring.errors")
        self.errors.KeyringError = type("KeyringError", (Exception,), {})  # type: ignore[attr-defined]
        self.locked = False
        self.keeps = False

    def get_password(self, service: str, name: str) -> str | None:
        if self.locked:
            raise self.errors.KeyringError("a secret of the system")
        return self.held.get((service, name))

    def set_password(self, service: str, name: str, passphrase: str) -> None:
        self.held[service, name] = passphrase

    def delete_password(self, service: str, name: str) -> None:
        if self.keeps:
            raise self.errors.KeyringError("a secret of the system")
        if (service, name) not in self.held:
            raise self.errors.KeyringError
        del self.held[service, name]


@pytest.fixture
def ring(monkeypatch: pytest.MonkeyPatch) -> Ring:
    made = Ring()
    monkeypatch.setitem(sys.modules, "keyring", made)
    monkeypatch.setitem(sys.modules, "keyring.errors", made.errors)
    return made


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    Keystore.create(tmp_path / "default.wallet", WORDS, "tea", CHEAP)
    (tmp_path / "passphrase").write_text("tea\n")
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(tmp_path / "passphrase"))

    def opened(path: Path, passphrase: str) -> None:
        raise BlockRobotError("NOT_FOUND", f"opened with {passphrase}")

    monkeypatch.setattr(opening, "load_genesis", lambda _: None)
    monkeypatch.setattr(opening.Keystore, "open", opened)
    return tmp_path


def run(place: Path, *arguments: str) -> Result:
    return CliRunner().invoke(wallet, ["--wallet-dir", str(place), *arguments])


def test_without_the_package_it_is_refused_with_what_to_install(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "keyring", None)
    for arguments in (["keyring", "store"], ["keyring", "forget"], ["--keyring", "records"]):
        refused = run(place, *arguments)
        assert refused.exit_code == 1
        assert "EXTRA_MISSING" in refused.stderr
        assert "pip install 'blockrobot[keyring]'" in refused.stderr


def test_a_passphrase_is_kept_used_on_request_and_forgotten(
    place: Path, ring: Ring, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as real:
        real.setattr(opening.Keystore, "open", lambda *_: None)
        stored = run(place, "keyring", "store", "--json")
    assert stored.exit_code == 0, stored.output
    assert "tea" not in stored.output
    assert list(ring.held.values()) == ["tea"]
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", "/nowhere")
    assert "opened with tea" in run(place, "--keyring", "records").stderr
    assert "FILE_UNUSABLE" in run(place, "records").stderr, "nothing comes from the keyring unasked"
    monkeypatch.setenv("BLOCKROBOT_KEYRING", "1")
    assert "opened with tea" in run(place, "records").stderr
    assert run(place, "keyring", "forget").exit_code == 0
    assert ring.held == {}
    assert run(place, "keyring", "forget").exit_code == 3


def test_what_does_not_open_the_wallet_is_not_kept(place: Path, ring: Ring) -> None:
    assert run(place, "keyring", "store").exit_code == 3
    assert ring.held == {}


def test_an_empty_or_locked_keyring_is_refused_and_tells_no_secret(place: Path, ring: Ring) -> None:
    assert "KEYRING_EMPTY" in run(place, "--keyring", "records").stderr
    ring.locked = True
    refused = run(place, "--keyring", "records")
    assert "KEYRING_UNUSABLE" in refused.stderr
    assert "secret" not in refused.stderr


def test_what_a_locked_keyring_may_still_have_is_not_called_forgotten_or_absent(ring: Ring, place: Path) -> None:
    ring.held["blockrobot-wallet", str((place / "default.wallet").resolve())] = "tea"
    for trouble in ("locked", "keeps"):
        setattr(ring, trouble, True)
        done = run(place, "keyring", "forget")
        assert done.exit_code == 1
        assert "KEYRING_UNUSABLE" in done.output
        assert "a secret" not in done.output
        setattr(ring, trouble, False)
    assert ring.held
