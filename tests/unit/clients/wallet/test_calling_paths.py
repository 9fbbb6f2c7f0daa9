"""A folder or a file may be called like the wallet's command: what is told of it stays as it is, however often."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clients.wallet.presentation.invocation import WALLET_COMMAND, called, with_command_prefix
from clients.wallet.presentation.translations import LANGUAGES, describe_error
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from tests.world.dicts import typed_for

NAMED_LIKE_IT = Path("/srv/blockrobot wallet")
PIECES = st.sampled_from(
    [WALLET_COMMAND, " ", "/", "'", '"', "`", ".", ":", "--", "--profile ann", "records", "{", "}", "\n", "\\", "$&"]
)
TOLD = st.lists(PIECES | st.text(max_size=3), max_size=12).map("".join)
PLACES = st.none() | TOLD.map(lambda name: Path("/srv") / name)


@pytest.mark.parametrize("behind", ["/ann.wallet", "'", '"', ".old", "s"])
def test_a_name_that_begins_like_the_command_is_none(behind: str) -> None:
    with typed_for("ann"):
        assert with_command_prefix(f"Look at x {WALLET_COMMAND}{behind}") == f"Look at x {WALLET_COMMAND}{behind}"


@pytest.mark.parametrize("behind", [" records", "`", "`.", ".", ", then", ":", "\n", "", " (then)", ")"])
def test_a_command_is_called_as_this_wallet_is_before_whatever_ends_it(behind: str) -> None:
    with typed_for("ann"):
        assert with_command_prefix(f"Run (`{WALLET_COMMAND}{behind}") == f"Run (`{WALLET_COMMAND} --profile ann{behind}"


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("folder", [NAMED_LIKE_IT, Path("my blockrobot wallet of old")])
def test_an_error_names_the_file_that_it_is_about(language: str, folder: Path) -> None:
    errors = [
        refusal("WALLET_NOT_FOUND", "wallet_not_found", path=str(folder)),
        BlockRobotError("FILE_UNUSABLE", f"{folder}: Permission denied."),
    ]
    with typed_for("ann", wallet_dir=folder):
        for error in errors:
            detail, next_step = describe_error(error, language)
            assert str(folder) in detail
            assert "--profile" not in detail
            assert WALLET_COMMAND not in next_step.replace(called(), "")


@given(told=TOLD, wallet_dir=PLACES, genesis=PLACES)
def test_twice_is_as_good_as_once_whatever_folders_are_called(
    told: str, wallet_dir: Path | None, genesis: Path | None
) -> None:
    with typed_for("ann", wallet_dir=wallet_dir, genesis=genesis):
        for has_fields in (False, True):
            once = with_command_prefix(told, has_fields=has_fields)
            assert with_command_prefix(once, has_fields=has_fields) == once


@given(place=TOLD)
def test_a_wallet_in_a_folder_of_any_name_is_named_once(place: str) -> None:
    with typed_for("ann", wallet_dir=Path("/srv") / place):
        assert with_command_prefix(f"Run {WALLET_COMMAND} records") == f"Run {called()} records"
        assert with_command_prefix(called()) == called()
