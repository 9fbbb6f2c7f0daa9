"""Commands of the wallet and of officers, called in this process on wallets that are open already."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from clients.wallet.cli import main
from clients.wallet.commands import share_commands
from clients.wallet.ledger.wallet import Wallet
from tests.world.sharing import SharedWard

MODULES = [
    import_module(f"clients.{place}")
    for place in (
        *("officer.breach_commands", "officer.lost_keys_commands", "officer.officer_mandates_commands"),
        *("wallet.commands.audit_commands", "wallet.commands.consent_commands", "wallet.commands.erase_commands"),
        *("wallet.commands.export_commands", "wallet.commands.inbox_commands", "wallet.commands.mandates_commands"),
        *("wallet.commands.notice_commands", "wallet.commands.records_commands", "wallet.commands.rights_commands"),
        *("wallet.commands.share_commands", "wallet.commands.view_commands"),
    )
]
"""Those whose commands act on a wallet that was opened."""


def open_for_commands(monkeypatch: pytest.MonkeyPatch, opened: Callable[[], Wallet]) -> None:
    """Let every command act on the wallet that is `opened` by then, in place of one from a file."""

    def run_with_wallet(_: click.Context, action: Callable[[Wallet], Awaitable[Any]]) -> Any:
        return asyncio.run(action(opened()))  # type: ignore[arg-type]

    for module in MODULES:
        monkeypatch.setattr(module, "run_with_wallet", run_with_wallet)


def sit_at_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands that are called in this process take what a test types for somebody at a terminal."""
    stream = "click.testing._NamedTextIOWrapper.isatty"
    monkeypatch.setattr(stream, lambda self: self.name == "<stdin>", raising=False)


class People:
    """A ward, a doctor, and their command lines."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ward = SharedWard(folder)
        self.doctor = self.ward.come_in("doctor", "staff")
        self.opened = self.ward.wallet
        open_for_commands(monkeypatch, lambda: self.opened)
        monkeypatch.setattr(share_commands.time, "time_ns", lambda: self.ward.chain.time_ms * 1_000_000)

    def run(self, wallet: Wallet, *arguments: object, typed: str | None = None) -> Result:
        self.opened = wallet
        result = CliRunner().invoke(main.wallet, [str(each) for each in arguments], input=typed)
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        return result

    def told(self, wallet: Wallet, *arguments: object) -> Any:
        result = self.run(wallet, *arguments, "--json")
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    def share(self, record_id: bytes, *more: object) -> Result:
        handle = self.doctor.store.content.handle.hex()
        arguments = [record_id.hex(), "--with", handle, "--as", "Dr Weber", "--purpose", "care", "--for", "7d", *more]
        return self.run(self.ward.wallet, "share", *arguments)
