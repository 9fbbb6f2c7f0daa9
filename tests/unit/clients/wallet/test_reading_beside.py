"""Commands that only read go on beside a program that has the wallet, and leave its file as it is; no other does."""

from __future__ import annotations

import functools
import json
import logging
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from clients.officer.breach_commands import officer
from clients.sdk.terminal.terminal import handle_errors
from clients.wallet.cli import wallet_context
from clients.wallet.cli.main import wallet
from clients.wallet.cli.wallet_context import read_only_wallet, run_with_wallet
from clients.wallet.store import wallet_lock
from tests.world.stolen import WalletHarness

READING = {
    "wallet": {
        *("records", "view", "verify", "audit", "erasures", "receipts", "shares", "inbox", "handle"),
        *("consent list", "mandates list"),
    },
    "officer": {"breaches", "lost-keys list", "lost-keys preview", "mandates list"},
}


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> WalletHarness:
    for name in ("claim_wallet", "lock_or_read_only"):
        at_once = functools.partial(getattr(wallet_lock, name), wait_s=0, sleep=lambda _: None)
        monkeypatch.setattr(wallet_context, name, at_once)
    return WalletHarness(tmp_path, monkeypatch)


def test_what_is_read_beside_another_program_leaves_the_file_as_it_was_and_what_writes_waits_for_it(
    desk: WalletHarness, caplog: pytest.LogCaptureFixture
) -> None:
    """Such as one that waits for a minute until all custodians have erased."""
    path, late = desk.story.path, desk.story.visit(2)
    before, busy = path.read_bytes(), f"`{desk.command} erase` (process"
    with (
        click.Context(click.Command("erase"), info_name="blockrobot wallet erase"),
        wallet_lock.claim_wallet(path),
        caplog.at_level(logging.INFO),
    ):
        seen = desk.run("records", "--json")
        assert (seen.exit_code, late.owner.hex() in seen.stdout) == (0, True), seen.output
        assert busy in seen.stderr
        assert all(words in seen.stderr for words in ("read beside it", "nothing new is noted"))
        refused = desk.rotate("--json")
        assert json.loads(refused.stdout)["error"]["code"] == "WALLET_BUSY"
        assert busy in desk.run("leave", "--yes").stderr
        assert path.read_bytes() == before
    assert "is dropped" in caplog.text
    assert desk.run("records", "--json").stderr == ""
    assert path.read_bytes() != before, "by itself it notes what it found"


def test_a_long_reading_of_the_ledger_says_how_far_it_is(desk: WalletHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clients.wallet.ledger.wallet.SCAN_SAVED_EVERY_COUNT", 2)
    for number in range(2, 6):
        desk.story.visit(number)
    seen = desk.run("records", "--json")
    assert (seen.exit_code, len(json.loads(seen.stdout)["visits"])) == (0, 5), seen.output
    assert seen.stderr.splitlines() == [
        "Read so far: 2 of 5 entries of the ledger ...",
        "Read so far: 4 of 5 entries of the ledger ...",
    ]
    assert desk.run("records", "--json").stderr == "", "the next time there is nothing left to read"


@pytest.mark.parametrize("is_marked", [False, True])
def test_a_command_is_let_through_for_its_mark_and_not_for_its_name(desk: WalletHarness, is_marked: bool) -> None:
    async def nothing(_: Any) -> None: ...

    def act(ctx: click.Context) -> None:
        run_with_wallet(ctx, nothing)

    action = handle_errors(read_only_wallet(act) if is_marked else act)
    command = click.Command("list", callback=click.pass_context(action))
    with wallet_lock.claim_wallet(desk.story.path):
        done = CliRunner().invoke(command, obj=(desk.story.path, desk.folder / "genesis.json"))
    assert (done.exit_code == 0) == is_marked
    assert ("WALLET_BUSY" in done.output) != is_marked


def marked(group: click.Group, above: str = "") -> set[str]:
    found = set()
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            found |= marked(command, f"{above}{name} ")
        elif getattr(command.callback, wallet_context._READS_ONLY_MARK, False):
            found.add(f"{above}{name}")
    return found


def test_these_commands_only_read() -> None:
    assert marked(wallet) == READING["wallet"]
    assert marked(officer) == READING["officer"]
