"""The passphrase in a keyring, with the package that speaks to it: kept, used, forgotten; and keyrings that fail.

No desktop is here: the keyring is one that keeps a file, named as the package lets a person name one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from clients.wallet.store.keystore import Keystore
from tests.ui.typed import Typed, at_terminal, plain
from tests.world.dicts import CHEAP

WORDS = " ".join(["abandon"] * 23 + ["art"])
PASSPHRASE = "violet kettle orbit sandwich"
FILE_KEYRING = "keyrings.alt.file.PlaintextKeyring"


class Home:
    """A wallet, and a keyring of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.wallet = folder / "wallets" / "ann.wallet"
        self.ring = folder / "data" / "python_keyring" / "keyring_pass.cfg"
        Keystore.create(self.wallet, WORDS, PASSPHRASE, CHEAP)

    def type(self, *arguments: str, keyring: str | None = FILE_KEYRING, environment: Mapping[str, str] = {}) -> Typed:
        """Begin a command of her wallet, the keyring being the one named, or the one that the package finds."""
        found = {"XDG_DATA_HOME": str(self.folder / "data"), "XDG_CONFIG_HOME": str(self.folder / "config")}
        named = {} if keyring is None else {"PYTHON_KEYRING_BACKEND": keyring}
        return at_terminal(self.folder, "--profile", "ann", *arguments, environment=found | named | dict(environment))

    def store(self, passphrase: str = PASSPHRASE, keyring: str | None = FILE_KEYRING) -> Typed:
        """Begin to put the passphrase into the keyring, and type it."""
        typed = self.type("keyring", "store", keyring=keyring)
        typed.answer("Passphrase: ", passphrase)
        return typed


@pytest.fixture
def home(tmp_path: Path) -> Home:
    return Home(tmp_path)


def test_a_passphrase_is_kept_used_when_it_is_asked_for_and_forgotten(home: Home) -> None:
    kept = home.store()
    assert kept.ended() == 0, kept.rest()
    told = plain(kept.rest())
    assert "The keyring has the passphrase now" in told
    assert "blockrobot wallet --profile ann --keyring COMMAND" in told
    assert home.ring.stat().st_mode & 0o777 == 0o600

    opened = home.type("--keyring", "guardians")
    opened.expect("knows of no guardians")
    assert opened.ended() == 0
    unasked = home.type("guardians", environment={"BLOCKROBOT_KEYRING": "1"})
    unasked.expect("knows of no guardians")
    assert unasked.ended() == 0
    asked = home.type("guardians")
    asked.expect("Passphrase: ")
    assert asked.ended_by_ctrl_c() == 1

    forgotten = home.type("keyring", "forget")
    forgotten.expect("The keyring has it no more")
    assert forgotten.ended() == 0
    for arguments in (("--keyring", "guardians"), ("keyring", "forget")):
        empty = home.type(*arguments)
        empty.expect("KEYRING_EMPTY. Next step: Put it there with `blockrobot wallet --profile ann keyring store`")
        assert empty.ended() == 3


def test_what_a_keyring_that_keeps_all_readable_means_is_said(home: Home) -> None:
    named = home.store()
    named.expect("PlaintextKeyring.*whoever reads your files may read the passphrase")
    assert named.ended() == 0


def test_a_keyring_that_protects_little_is_not_taken_unless_it_is_named(home: Home) -> None:
    found = home.store(keyring=None)
    found.expect("(?s)PlaintextKeyring.*PYTHON_KEYRING_BACKEND.*KEYRING_UNUSABLE. Next step: ")
    assert found.ended() == 1
    assert not home.ring.exists()


def test_what_does_not_open_the_wallet_is_not_kept(home: Home) -> None:
    wrong = home.store("violet kettle orbit")
    wrong.expect("WALLET_PASSPHRASE_WRONG. Next step: ")
    assert wrong.ended() == 4
    assert not home.ring.exists()


@pytest.mark.parametrize(
    ("keyring", "why"),
    [
        ("keyring.backends.fail.Keyring", "took nothing: NoKeyringError"),
        ("keyring.backends.null.Keyring", "kept nothing"),
    ],
    ids=["none on this machine", "one that is switched off"],
)
def test_a_keyring_that_does_not_keep_it_is_never_said_to_have_it(home: Home, keyring: str, why: str) -> None:
    typed = home.store(keyring=keyring)
    typed.expect(f"(?s){why}.*KEYRING_UNUSABLE. Next step: ")
    assert typed.ended() == 1
    assert "Traceback" not in typed.rest()
    assert "has the passphrase" not in typed.rest()


@pytest.mark.parametrize("arguments", [("--keyring", "guardians"), ("keyring", "forget"), ("keyring", "store")])
def test_a_keyring_that_is_not_installed_is_named_before_anything_is_asked(
    home: Home, arguments: tuple[str, ...]
) -> None:
    typed = home.type(*arguments, keyring="nobody.knows.Keyring")
    typed.expect("(?s)nobody.knows.Keyring, which is no keyring here.*KEYRING_UNUSABLE. Next step: ")
    assert typed.ended() == 1
    assert "Traceback" not in typed.rest()


@pytest.mark.parametrize("arguments", [("--keyring", "guardians"), ("keyring", "forget"), ("keyring", "store")])
def test_a_damaged_keyring_is_told_in_a_sentence(home: Home, arguments: tuple[str, ...]) -> None:
    home.ring.parent.mkdir(parents=True)
    home.ring.write_text("nobody's format\n")
    typed = home.store() if arguments[-1] == "store" else home.type(*arguments)
    typed.expect("MissingSectionHeaderError.*(?s:.)*KEYRING_UNUSABLE. Next step: ")
    assert typed.ended() == 1
    assert "Traceback" not in typed.rest()
    assert home.ring.read_text() == "nobody's format\n"
