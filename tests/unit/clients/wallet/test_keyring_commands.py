"""The keyring of a desktop that is locked, keeps what it is to give up, or has no package: a sentence and a next step.

With a keyring that does what it is told: `tests/ui/test_terminal_keyring.py`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import keyring
import pytest
from click.testing import CliRunner, Result
from keyring.backend import KeyringBackend
from keyring.backends import chainer, fail
from keyring.errors import KeyringLocked, PasswordDeleteError

from clients.wallet.cli.main import wallet
from clients.wallet.store.keystore import Keystore
from tests.world.dicts import CHEAP

WORDS = " ".join(["abandon"] * 23 + ["art"])


class Ring(KeyringBackend):
    """What a desktop's keyring does and one in a file never: it is locked, or keeps what it is to give up."""

    priority = 5.0

    def __init__(self) -> None:
        super().__init__()
        self.held: dict[tuple[str, str], str] = {}
        self.is_locked = False
        self.locks_behind_itself = False

    def get_password(self, service: str, username: str) -> str | None:
        if self.is_locked:
            raise KeyringLocked("a secret of the system")
        return self.held.get((service, username))

    def set_password(self, service: str, username: str, password: str) -> None:
        if self.is_locked:
            raise KeyringLocked("a secret of the system")
        self.held[service, username] = password
        self.is_locked = self.locks_behind_itself

    def delete_password(self, service: str, username: str) -> None:
        raise PasswordDeleteError("a secret of the system")


class Weak(Ring):
    """One that the package does not recommend."""

    priority = 0.6


class Weaker(Ring):
    """One that it recommends even less."""

    priority = 0.5


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
        assert "make install-keyring" in refused.stderr


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


def test_what_the_keyring_took_and_does_not_show_is_not_called_untaken(ring: Ring, place: Path) -> None:
    ring.locks_behind_itself = True
    done = run(place, "keyring", "store")
    assert done.exit_code == 1
    assert "The keyring may have it: KeyringLocked." in done.output
    assert "took nothing" not in done.output
    assert list(ring.held.values()) == ["tea"]


@pytest.fixture
def unnamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user who named no keyring; returns the file in which she could."""
    monkeypatch.delenv("PYTHON_KEYRING_BACKEND", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setattr(keyring.core, "_keyring_backend", None)
    named = tmp_path / "config" / "python_keyring" / "keyringrc.cfg"
    named.parent.mkdir(parents=True)
    return named


def use_all(monkeypatch: pytest.MonkeyPatch, *rings: Ring) -> None:
    """Let these be all keyrings of the machine: from two on the package puts a chain before them."""
    monkeypatch.setattr("keyring.backend.get_all_keyring", lambda: list(rings))
    chain = chainer.ChainerBackend()
    assert chain.priority == 10, "the chain itself is recommended, whatever is in it"
    monkeypatch.setattr(keyring.core, "_keyring_backend", chain)


def test_several_keyrings_that_protect_little_are_not_taken_for_one_that_does(
    unnamed: Path, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weaker, weak = Weaker(), Weak()
    use_all(monkeypatch, weaker, weak)
    refused = run(place, "keyring", "store")
    assert refused.exit_code == 1
    assert "The best keyring here is Weak, which protects little." in refused.stderr
    assert f"PYTHON_KEYRING_BACKEND={Weak.__module__}.Weak" in refused.stderr
    assert weak.held == weaker.held == {}


def test_of_several_keyrings_the_strongest_is_what_counts(
    unnamed: Path, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weak, strong = Weak(), Ring()
    use_all(monkeypatch, weak, strong)
    kept = run(place, "keyring", "store", "--json")
    assert (kept.exit_code, json.loads(kept.stdout)["weak_keyring"]) == (0, None), kept.output
    assert (list(strong.held.values()), weak.held) == (["tea"], {})


def test_a_keyring_is_named_in_the_package_s_own_file_too(unnamed: Path, place: Path) -> None:
    unnamed.write_text("[backend]\ndefault-keyring=keyrings.alt.file.PlaintextKeyring\n")
    kept = run(place, "keyring", "store", "--json")
    assert kept.exit_code == 0, kept.output
    assert json.loads(kept.stdout)["weak_keyring"] == "PlaintextKeyring"


def test_where_there_is_no_keyring_none_is_recommended(
    unnamed: Path, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keyring.core, "_keyring_backend", fail.Keyring())
    refused = run(place, "keyring", "store")
    assert refused.exit_code == 1
    assert "There is no keyring here." in refused.stderr
    assert "PYTHON_KEYRING_BACKEND=" not in refused.stderr, "none is named that could be used"


@pytest.mark.parametrize("name", ["keyrings.no.such.Ring", "keyring.backends.fail.Kering", "Ring"])
def test_a_keyring_whose_name_is_misspelt_is_told_before_the_passphrase_is_asked_for(
    unnamed: Path, place: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("PYTHON_KEYRING_BACKEND", name)
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(place / "nowhere"))
    for arguments in (("keyring", "store"), ("keyring", "forget")):
        refused = run(place, *arguments)
        assert refused.exit_code == 1
        assert f"PYTHON_KEYRING_BACKEND names {name}, which is no keyring here." in refused.stderr
        assert "KEYRING_UNUSABLE. Next step: " in refused.stderr


def test_refusals_of_a_keyring_are_told_in_portuguese_with_a_next_step_that_fits(
    unnamed: Path, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    weak = Weak()
    use_all(monkeypatch, Weaker(), weak)
    refused = run(place, "keyring", "store")
    setting = f"PYTHON_KEYRING_BACKEND={Weak.__module__}.Weak"
    assert f"O melhor porta-chaves daqui é Weak, que protege pouco. Para o usar mesmo assim, defina {setting}." in (
        refused.stderr
    )
    assert "escolha outro com PYTHON_KEYRING_BACKEND" in refused.stderr
    monkeypatch.setattr(keyring.core, "_keyring_backend", fail.Keyring())
    assert "Não há aqui nenhum porta-chaves." in run(place, "keyring", "store").stderr
    locked = Ring()
    locked.is_locked = True
    monkeypatch.setattr(keyring.core, "_keyring_backend", locked)
    refused = run(place, "keyring", "store")
    assert "O porta-chaves não aceitou nada: KeyringLocked." in refused.stderr
    assert "The keyring" not in refused.stderr
