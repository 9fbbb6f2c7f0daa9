"""The keyring of a desktop that is locked, keeps what it is to give up, or has no package: a sentence and a next step.

With a keyring that does what it is told: `tests/ui/test_terminal_keyring.py`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import keyring
import pytest
from click.testing import CliRunner, Result
from keyring.backend import KeyringBackend
from keyring.errors import KeyringLocked, PasswordDeleteError

from clients.wallet.cli import wallet
from clients.wallet.keystore import Keystore
from tests.unit.clients.wallet.conftest import CHEAP

WORDS = " ".join(["abandon"] * 23 + ["art"])


class Ring(KeyringBackend):
    """What a desktop's keyring does and one in a file never: it is locked, or keeps what it is to give up."""

    priority = 5.0

    def __init__(self) -> None:
        super().__init__()
        self.held: dict[tuple[str, str], str] = {}
        self.is_locked = False

    def get_password(self, service: str, username: str) -> str | None:
        if self.is_locked:
            raise KeyringLocked("a secret of the system")
        return self.held.get((service, username))

    def set_password(self, service: str, username: str, password: str) -> None:
        if self.is_locked:
            raise KeyringLocked("a secret of the system")
        self.held[service, username] = password

    def delete_password(self, service: str, username: str) -> None:
        raise PasswordDeleteError("a secret of the system")


@pytest.fixture
def ring() -> Iterator[Ring]:
    made, before = Ring(), keyring.get_keyring()
    keyring.set_keyring(made)
    yield made
    keyring.set_keyring(before)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    Keystore.create(tmp_path / "default.wallet", WORDS, "tea", CHEAP)
    (tmp_path / "passphrase").write_text("tea\n")
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(tmp_path / "passphrase"))
    return tmp_path


def run(place: Path, *arguments: str) -> Result:
    return CliRunner().invoke(wallet, ["--wallet-dir", str(place), *arguments])


def test_without_the_package_it_is_refused_with_what_to_install(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "keyring", None)
    for arguments in (["keyring", "store"], ["keyring", "forget"], ["--keyring", "guardians"]):
        refused = run(place, *arguments)
        assert refused.exit_code == 1
        assert "EXTRA_MISSING" in refused.stderr
        assert "pip install 'blockrobot[keyring]'" in refused.stderr


def test_a_locked_keyring_is_refused_and_tells_no_secret(place: Path, ring: Ring) -> None:
    assert "KEYRING_EMPTY" in run(place, "--keyring", "guardians").stderr
    ring.is_locked = True
    for arguments in (["keyring", "store"], ["--keyring", "guardians"]):
        refused = run(place, *arguments)
        assert refused.exit_code == 1
        assert "KeyringLocked" in refused.stderr
        assert "KEYRING_UNUSABLE" in refused.stderr
        assert "secret" not in refused.stderr


def test_what_a_keyring_may_still_have_is_not_called_forgotten_or_absent(ring: Ring, place: Path) -> None:
    assert run(place, "keyring", "store").exit_code == 0
    for is_locked in (False, True):
        ring.is_locked = is_locked
        done = run(place, "keyring", "forget")
        assert done.exit_code == 1
        assert "The keyring may still have it" in done.output
        assert "KEYRING_UNUSABLE" in done.output
        assert "a secret" not in done.output
    assert list(ring.held.values()) == ["tea"]
