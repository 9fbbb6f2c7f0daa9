"""Registering at the command line: nobody consents to anything that was not named."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from click.testing import CliRunner

from clients.sdk.enrolment import Registration
from clients.wallet import cli


class Desk:
    """A wallet that is open, and what it was asked to register with."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, list[str]]] = []

    async def register(self, code: str, purposes: list[str]) -> Registration:
        self.asked.append((code, purposes))
        return Registration(member=b"M" * 33, txid=b"T" * 32)


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch) -> Desk:
    opened = Desk()

    def run_opened(_: Any, work: Callable[[Desk], Awaitable[Registration]]) -> Registration:
        async def main() -> Registration:
            return await work(opened)

        return asyncio.run(main())

    monkeypatch.setattr(cli, "run_opened", run_opened)
    return opened


def run(*arguments: str) -> str:
    result = CliRunner().invoke(cli.wallet, ["--genesis", "genesis.json", "register", *arguments])
    assert result.exit_code == 0, result.output
    return result.output


def test_who_names_no_purpose_consents_to_nothing_and_is_told(desk: Desk) -> None:
    assert "consented to nothing" in run("BR1-CODE")
    assert json.loads(run("BR1-CODE", "--json"))["purposes"] == []
    assert desk.asked == [("BR1-CODE", [])] * 2


def test_who_names_purposes_consents_to_these(desk: Desk) -> None:
    assert "for: care, demo." in run("BR1-CODE", "--purpose", "care", "--purpose", "demo")
    assert desk.asked == [("BR1-CODE", ["care", "demo"])]
