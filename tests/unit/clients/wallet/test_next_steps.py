"""Every next step that a wallet tells can be typed as it stands: it names this very wallet, and the file that it trusts."""

from __future__ import annotations

import re
import shlex
import string
from pathlib import Path

import pytest

from clients.sdk.terminal.terminal import home_folder
from clients.wallet.cli.group_options import place_wallet
from clients.wallet.presentation.guardian_sheets import build_sheet
from clients.wallet.presentation.invocation import WALLET_COMMAND, called, verify_command, with_command_prefix
from clients.wallet.presentation.translations import LANGUAGES, describe_error, section, text
from clients.wallet.recovery.slip39_shares import split_mnemonic
from clients.wallet.store.keystore import GuardianSet
from clients.wallet.text_catalogue import Form, load
from consensus.contract_refusals import NEXT_STEPS
from consensus.errors import CATALOGUE, BlockRobotError
from tests.world.dicts import typed_for

ANYBODYS = re.compile(rf"{WALLET_COMMAND}(?! --)")
PLACES = {"wallet_dir": Path("/srv/{my} wallets"), "genesis": Path("/srv/genesis.json")}
IN_FULL = "blockrobot wallet --profile ann --wallet-dir '/srv/{my} wallets' --genesis /srv/genesis.json"


def values_of(form: Form) -> dict[str, int]:
    texts = [form] if isinstance(form, str) else list(form.values())
    fields = {name for one in texts for _, name, _, _ in string.Formatter().parse(one) if name is not None}
    return dict.fromkeys({"count", *fields}, 2)


def own_texts(language: str) -> dict[str, Form]:
    return {key: form for key, form in load(language).items() if not key.startswith(("page.", "errors.", "refusals."))}


def test_a_wallet_is_called_with_what_was_named_for_it_and_nothing_else() -> None:
    assert called() == "blockrobot wallet"
    with typed_for("default"):
        assert called() == "blockrobot wallet"
    with typed_for("ann"):
        assert called() == "blockrobot wallet --profile ann"
    with typed_for("ann", **PLACES):
        assert called() == IN_FULL
        assert shlex.split(called())[5] == "/srv/{my} wallets"


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_text_names_the_command_of_another_wallet(language: str) -> None:
    told = 0
    with typed_for("ann", **PLACES):
        for key, form in own_texts(language).items():
            said = text(key, language=language, **values_of(form))
            assert not ANYBODYS.search(said), (key, said)
            told += IN_FULL in said
    assert told >= 40


def refused(code: str) -> BlockRobotError:
    return BlockRobotError("CALL_REFUSED", f"{code}: no.", contract_code=code)


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_error_names_the_command_of_another_wallet(language: str) -> None:
    told = 0
    errors = [BlockRobotError(code) for code in CATALOGUE]
    errors += [refused(code) for code in NEXT_STEPS]
    with typed_for("ann"):
        for error in errors:
            said = " ".join(describe_error(error, language))
            assert not ANYBODYS.search(said), said
            told += "blockrobot wallet --profile ann" in said
    assert told > 20


@pytest.mark.parametrize("language", LANGUAGES)
def test_what_the_page_says_names_its_own_wallet(language: str) -> None:
    with typed_for("ann"):
        assert "blockrobot wallet --profile ann look" in str(section("page", language)["inbox.receivedNext"])


def test_it_is_said_once_however_often_a_text_goes_through_and_what_people_wrote_stays() -> None:
    with typed_for("ann", **PLACES):
        once = with_command_prefix("Run: blockrobot wallet records. Or: blockrobot wallet --profile NAME restore.")
        assert once == f"Run: {IN_FULL} records. Or: blockrobot wallet --profile NAME restore."
        assert with_command_prefix(once) == once
        assert "by blockrobot wallet fans" in text("records.notice_changed", organisation="by blockrobot wallet fans")


def test_a_guardian_s_sheet_tells_no_profile_and_no_folder_of_the_owner() -> None:
    made = GuardianSet(1_800_000_000_000, 2, ["Ann", "Ben"], 4711, 0)
    share = split_mnemonic(" ".join(["abandon"] * 23 + ["art"]), 2, 2)[0]
    plain = build_sheet(made, 0, share)
    assert "blockrobot wallet guardians recover" in plain
    with typed_for("work", **PLACES):
        assert build_sheet(made, 0, share) == plain


def test_what_another_has_to_type_names_no_profile_of_ours() -> None:
    with typed_for("ann"):
        for language in LANGUAGES:
            for code in ("SHARE_WITH_NON_MEMBER", "HANDLE_MISTYPED", "HANDLE_NOT_FOUND"):
                assert "`wallet handle`" in describe_error(BlockRobotError(code), language)[1]
            for code in (*CATALOGUE, *NEXT_STEPS):
                error = BlockRobotError(code) if code in CATALOGUE else refused(code)
                assert "--profile ann handle" not in describe_error(error, language)[1], code


def test_a_file_is_checked_against_the_network_that_the_wallet_trusts(tmp_path: Path) -> None:
    usual = place_wallet("default", None, None)[1]
    assert usual == home_folder() / "network" / "genesis.json"
    assert verify_command("mine.zip") == f"blockrobot verify mine.zip --genesis {shlex.quote(str(usual.absolute()))}"
    for language in LANGUAGES:
        assert text("export.next", language=language, check="COMMAND").endswith("\n  COMMAND")
    with typed_for("ann", genesis=tmp_path / "of ours.json"):
        assert verify_command(Path("my data.zip")) == (
            f"blockrobot verify 'my data.zip' --genesis '{tmp_path / 'of ours.json'}'"
        )
