"""Which exit code each error ends in: all of the catalogue, and what the reference says of them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from clients.sdk.terminal.terminal import fail
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.exit_codes import (
    EXIT_FAILED,
    EXIT_NOT_FINAL,
    EXIT_NOT_FOUND,
    EXIT_REFUSED,
    EXIT_USAGE,
    MEANINGS,
    WRONG_OPTIONS,
    exit_code_of,
)

ENDED_OTHERWISE = {"CERTIFICATE_EXPIRED", "TRANSACTION_EXPIRED"}
"""What is over for the network, where nobody refuses the person who typed the command."""
REFERENCE = Path(__file__).parents[3] / "docs" / "reference"


def test_every_error_of_the_catalogue_ends_in_a_code_that_means_something_and_none_is_done() -> None:
    codes = {code: exit_code_of(entry) for code, entry in CATALOGUE.items()}
    assert set(codes.values()) == set(MEANINGS) - {0}
    assert {code for code, exit_code in codes.items() if exit_code == EXIT_USAGE} == WRONG_OPTIONS


@pytest.mark.parametrize("code", sorted(CATALOGUE))
def test_the_exit_code_says_what_the_status_says(code: str) -> None:
    entry = CATALOGUE[code]
    exit_code = exit_code_of(entry)
    if entry.status in {401, 403} or code.endswith("_REFUSED"):
        assert exit_code == EXIT_REFUSED
    elif entry.status in {404, 410}:
        assert exit_code == EXIT_NOT_FOUND
    elif entry.status == 504:
        assert exit_code == EXIT_NOT_FINAL
    elif code in WRONG_OPTIONS:
        assert (entry.status, exit_code) == (400, EXIT_USAGE)
    else:
        assert exit_code == EXIT_FAILED


@pytest.mark.parametrize("code", sorted(CATALOGUE))
def test_the_name_of_an_error_fits_how_a_command_ends_in_it(code: str) -> None:
    exit_code = exit_code_of(CATALOGUE[code])
    if code.endswith("_NOT_FOUND"):
        assert exit_code == EXIT_NOT_FOUND
    elif code.endswith(("_REFUSED", "_PASSPHRASE_WRONG", "_EXPIRED")) and code not in ENDED_OTHERWISE:
        assert exit_code == EXIT_REFUSED
    elif code.endswith(("_DAMAGED", "_BUSY", "_FULL", "_EXISTS", "_UNREACHABLE", "_UNAVAILABLE")):
        assert exit_code == EXIT_FAILED


@pytest.mark.parametrize(
    ("code", "exit_code"),
    [
        ("NODE_UNREACHABLE", 1),
        ("WALLET_DAMAGED", 1),
        ("WORDS_INVALID", 1),
        ("SENSOR_UNKNOWN", 2),
        ("PURPOSE_UNKNOWN", 2),
        ("NAME_TOO_SHORT", 2),
        ("SPAN_INVALID", 2),
        ("FAULT_UNKNOWN", 2),
        ("PROOF_INVALID", 1),
        ("WALLET_NOT_FOUND", 3),
        ("CLIP_ERASED", 3),
        ("GRANT_ENDED", 3),
        ("WALLET_PASSPHRASE_WRONG", 4),
        ("CALL_REFUSED", 4),
        ("SESSION_REFUSED", 4),
        ("ERASURE_NOT_CONFIRMED", 5),
        ("TRANSACTION_NOT_FINAL_IN_TIME", 5),
    ],
)
def test_what_people_meet_ends_as_they_would_say(code: str, exit_code: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert fail(BlockRobotError(code)) == exit_code
    assert f"{code}. Next step: " in capsys.readouterr().err


def test_the_reference_names_each_code_with_its_meaning() -> None:
    told = dict(re.findall(r"^\| (\d) \| (.+) \|$", (REFERENCE / "cli.md").read_text(encoding="utf-8"), re.MULTILINE))
    assert told == {str(code): meaning for code, meaning in MEANINGS.items()}
