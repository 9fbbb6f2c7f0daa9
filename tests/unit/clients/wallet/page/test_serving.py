"""`blockrobot wallet serve`: what it prints, which browser it opens, and what ends it."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shlex
import signal
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from clients.wallet.cli.main import wallet as wallet_command
from clients.wallet.commands import serve_commands
from clients.wallet.commands.serve_commands import ENDINGS
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.page import passphrase_check as passphrases
from clients.wallet.page.jobs import TOLD
from clients.wallet.page.page import make_page
from clients.wallet.page.session import PageSession
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE
from clients.wallet.text_catalogue import load
from consensus.errors import BlockRobotError
from tests.unit.clients.wallet.page.conftest import PASSPHRASE, PageHarness
from tests.wallet_page_client import WalletPage
from tests.world.sharing import SharedWard

Run = Any
READ_OVER = "when it is done and the lists are read again"


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Which addresses a browser was given; there is one."""
    seen: list[str] = []

    def open_browser(address: str) -> bool:
        seen.append(address)
        return True

    monkeypatch.setattr(webbrowser, "open", open_browser)
    monkeypatch.setenv("DISPLAY", ":0")
    return seen


@pytest.fixture
def run(ward: SharedWard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the command on Ann's wallet; the page ends by itself as soon as it has begun, as by Ctrl-C."""
    ward.wallet.store.save()
    monkeypatch.setattr(serve_commands, "load_genesis", lambda _: ward.genesis)
    secret = tmp_path / "passphrase"
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(secret))

    def make(store: object, _genesis: object) -> Wallet:
        ward.wallet.store = store  # type: ignore[assignment]
        return ward.wallet

    async def stop_at_once(_session: PageSession, _minutes: int) -> str:
        return "The page is closed."

    monkeypatch.setattr(serve_commands, "Wallet", make)
    monkeypatch.setattr(serve_commands, "_wait_until_over", stop_at_once)

    def start(*options: str, passphrase: str = PASSPHRASE) -> Any:
        secret.write_text(passphrase, encoding="utf-8")
        return CliRunner().invoke(
            wallet_command, ["--wallet-dir", str(tmp_path), "--profile", "ann", "serve", *options]
        )

    return start


def test_it_opens_the_browser_with_a_file_and_no_secret(run: Run, opened: list[str]) -> None:
    done = run()
    assert done.exit_code == 0, done.output
    (address,) = opened
    assert address.startswith("file:///")
    assert address.endswith(".html")
    assert "#" not in address
    assert "Ctrl-C: end" in done.output
    assert "closed" in done.output


def test_a_program_is_told_the_file_and_a_person_without_a_browser_too(run: Run, opened: list[str]) -> None:
    told = json.loads(run("--no-browser", "--json").stdout)
    assert (told["ok"], told["browser_opened"], opened) == (True, False, [])
    assert Path(told["redirect_file"]).parent.name == ".ann.page"
    assert not Path(told["redirect_file"]).exists(), "it goes with the page"
    assert re.fullmatch(r"http://127(\.\d+){3}:\d+/", told["url"])
    assert "#" not in told["url"]
    assert ".ann.page" in run("--no-browser").output


async def test_who_comes_by_an_old_link_is_told_so_in_her_language(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    served = make_page(desk.session)
    where = await served.start()
    assert 'lang="pt"' in where.redirect_file.read_text(encoding="utf-8")
    assert "uma só vez" in where.redirect_file.read_text(encoding="utf-8")
    async with WalletPage(where.redirect_file) as page:
        status, problem = await page.ask("POST", "/session", {"token": page.token})
    await served.stop()
    assert (status, problem["code"]) == (401, "PAGE_LINK_INVALID")
    assert problem["detail"] == load("pt")["errors.PAGE_LINK_INVALID.meaning"]
    assert problem["next_step"] == load("pt")["errors.PAGE_LINK_INVALID.next_step"]


def test_a_wrong_passphrase_opens_no_page(run: Run, opened: list[str]) -> None:
    done = run("--json", passphrase="coffee")
    assert (done.exit_code, json.loads(done.output)["error"]["code"]) == (4, "WALLET_PASSPHRASE_WRONG")
    assert opened == []


async def test_it_ends_when_nobody_uses_it_and_when_it_is_told_to(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serve_commands, "_LOOK_S", 0.001)
    desk.ward.chain.time_ms += 31 * 60_000
    assert "30 minutes" in await serve_commands._wait_until_over(desk.session, 30)
    desk.session.note_use()
    undo = serve_commands._end_in_order(desk.session)
    os.kill(os.getpid(), signal.SIGTERM)
    assert "closed" in await serve_commands._wait_until_over(desk.session, 30)
    undo()
    assert signal.getsignal(ENDINGS[0]) is signal.default_int_handler


@pytest.mark.parametrize("options", [(), ("--json",)], ids=["a person", "a program"])
@pytest.mark.parametrize("passphrase", [PASSPHRASE, "coffee"])
def test_an_erasure_whose_passphrase_is_still_checked_at_the_end_begins_or_is_said_not_to_have(
    run: Run, ward: SharedWard, passphrase: str, options: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, ids = ward.record_visit()
    go_on, answers, asking = threading.Event(), [], []

    async def ask_and_end(session: PageSession, _minutes: int) -> str:
        """Ask for an erasure, and return as by Ctrl-C while the passphrase is checked."""
        loop, begun, opens_with = asyncio.get_running_loop(), asyncio.Event(), session.wallet.store.opens_with

        def check_late(given: str) -> bool:
            loop.call_soon_threadsafe(begun.set)
            go_on.wait(timeout=10)
            return opens_with(given)

        async def ask() -> None:
            async with WalletPage(next(session.folder.glob("open-*.html"))) as page:
                wish = {"records": [each.hex() for each in ids], "passphrase": passphrase}
                answers.append((await page.ask("POST", "/api/erasures", wish))[0])

        async def settle_and_go_on() -> bool:
            go_on.set()
            return await settle()

        settle = session.gate.finish_checks
        monkeypatch.setattr(session.gate, "finish_checks", settle_and_go_on)
        monkeypatch.setattr(session.wallet.store, "opens_with", check_late)
        async with session.lock:
            await session.read()
        asking.append(asyncio.create_task(ask()))
        await begun.wait()
        session.ended.set()
        return "The page is closed."

    monkeypatch.setattr(serve_commands, "_wait_until_over", ask_and_end)
    height = ward.chain.head.height
    done = run("--no-browser", *options)
    go_on.set()
    is_right = passphrase == PASSPHRASE
    assert done.exit_code == (0 if is_right else 1), done.output
    assert answers == [202 if is_right else 403]
    assert (ward.chain.head.height > height) == is_right, "what was asked for is on the chain, or nothing is"
    if options:
        _, length = json.JSONDecoder().raw_decode(done.stdout)
        ended = done.stdout[length:].strip()
        assert (ended and json.loads(ended)) == ("" if is_right else {"ok": False, "unfinished": [], "not_begun": True})
    else:
        assert load("en")["serve.finishing"] in done.output
        assert ("was not begun" in done.output) != is_right


@pytest.mark.parametrize("is_left", [True, False], ids=["left by a second Ctrl-C", "checked for too long"])
async def test_what_is_not_waited_for_any_more_never_begins_behind_what_was_said(
    desk: PageHarness, is_left: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, begun, loop = threading.Event(), asyncio.Event(), asyncio.get_running_loop()

    def check_late(_: str) -> bool:
        loop.call_soon_threadsafe(begun.set)
        return go_on.wait(timeout=10)

    monkeypatch.setattr(desk.session.wallet.store, "opens_with", check_late)
    monkeypatch.setattr(passphrases, "SETTLE_MAX_S", 3_600.0 if is_left else 0.0)
    asked = asyncio.create_task(desk.session.gate.require(PASSPHRASE))
    await begun.wait()
    ending = asyncio.create_task(serve_commands._let_begin(desk.session, as_json=False))
    await asyncio.sleep(0)
    if is_left:
        ending.cancel()
    await asyncio.gather(ending, return_exceptions=True)
    assert "was not begun" in capsys.readouterr().out
    go_on.set()
    with pytest.raises(BlockRobotError, match=r"^PAGE_SESSION_REQUIRED:"):
        await asked


@pytest.fixture
def ask_last(ward: SharedWard, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Have something asked for on the page, and Ctrl-C pressed `at` that, so that it waits behind the page's reading."""

    leaving: list[asyncio.Task[None]] = []

    def prepare(path: str, wish: dict[str, Any], at: str = "while it waits") -> None:
        async def ask_and_end(session: PageSession, _minutes: int) -> str:
            await session.lock.acquire()
            await session.read()
            reading = asyncio.Event()
            if at == READ_OVER:
                monkeypatch.setattr(session.jobs, "_after", lambda: read_for_long(reading))
            async with WalletPage(next(session.folder.glob("open-*.html"))) as page:
                accepted = await page.post(path, wish)
            task = session.jobs.find(accepted["job"]).task
            assert task is not None
            if at == "and once more":
                leaving.append(asyncio.create_task(press_again_while_it_waits(session)))
                return "The page is closed."
            session.lock.release()
            if at == "when it is there and not saved":
                await task
            if at == READ_OVER:
                await reading.wait()
            if at == READ_OVER and session.jobs.are_decisions_open:
                leaving.append(asyncio.create_task(press_again_while_it_waits(session)))
            return "The page is closed."

        async def read_for_long(begun: asyncio.Event) -> None:
            begun.set()
            await asyncio.Event().wait()

        async def press_again_while_it_waits(session: PageSession) -> None:
            assert session._watching is not None
            await asyncio.wait([session._watching])
            for _ in range(5):
                await asyncio.sleep(0)
            os.kill(os.getpid(), signal.SIGINT)

        monkeypatch.setattr(serve_commands, "_wait_until_over", ask_and_end)

    return prepare


@pytest.mark.parametrize("language", ["en", "pt"])
def test_a_decision_that_fails_after_the_page_has_ended_is_said_to_have_failed_and_why(
    run: Run, ask_last: Callable[..., None], tmp_path: Path, language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    ask_last("/api/consents/give", {"purposes": ["care"], "sensors": ["depth"], "notice_version": 7})
    done = run("--no-browser")
    assert done.exit_code == 1, done.output
    assert load(language)["serve.unfinished.consent"] in done.output
    assert "NOTICE_NOT_SHOWN. " in done.output
    assert f"blockrobot wallet --profile ann --wallet-dir {shlex.quote(str(tmp_path))} serve" in done.output


def test_a_program_is_told_of_a_decision_that_failed_after_the_page_has_ended(
    run: Run, ask_last: Callable[..., None]
) -> None:
    ask_last("/api/consents/give", {"purposes": ["care"], "sensors": ["depth"], "notice_version": 7})
    done = run("--no-browser", "--json")
    opened, length = json.JSONDecoder().raw_decode(done.stdout)
    ended = json.loads(done.stdout[length:])
    assert (opened["ok"], ended["ok"], done.exit_code) == (True, False, 1)
    ((kind, error),) = [(one["kind"], one["error"]) for one in ended["unfinished"]]
    assert (kind, error["code"]) == ("consent", "NOTICE_NOT_SHOWN")


@pytest.mark.parametrize("at", ["while it waits", "when it is there and not saved"])
def test_a_file_to_take_along_that_nobody_saved_is_said_to_be_gone_and_no_part_of_it_stays(
    run: Run, ask_last: Callable[..., None], ward: SharedWard, tmp_path: Path, at: str
) -> None:
    ward.record_visit()
    ask_last("/api/exports", {"now": True, "identity": False, "passphrase": PASSPHRASE}, at)
    done = run("--no-browser")
    assert done.exit_code == 1, done.output
    assert load("en")["serve.unfinished.export"] in done.output
    assert not list((tmp_path / ".ann.page").iterdir())
    assert not list(tmp_path.rglob("*.zip*"))


def test_a_file_that_nobody_saved_is_told_once_though_the_lists_were_still_read_again(
    run: Run, ask_last: Callable[..., None], ward: SharedWard
) -> None:
    ward.record_visit()
    ask_last("/api/exports", {"now": True, "identity": False, "passphrase": PASSPHRASE}, READ_OVER)
    done = run("--no-browser")
    assert (done.exit_code, done.output.count(load("en")["serve.unfinished.export"])) == (1, 1), done.output


def test_a_decision_that_is_on_the_ledger_is_not_called_unfinished_though_the_lists_were_still_read_again(
    run: Run, ask_last: Callable[..., None], ward: SharedWard
) -> None:
    height = ward.chain.head.height
    ask_last("/api/consents/refuse", {"purposes": ["care"], "sensors": ["depth"]}, READ_OVER)
    done = run("--no-browser")
    assert ward.chain.head.height > height
    assert load("en")["serve.unfinished.consent"] not in done.output


def test_a_decision_that_is_left_by_a_second_ctrl_c_is_said_to_be_left(
    run: Run, ask_last: Callable[..., None], ward: SharedWard
) -> None:
    height = ward.chain.head.height
    ask_last("/api/consents/refuse", {"purposes": ["care"], "sensors": ["depth"]}, "and once more")
    done = run("--no-browser")
    assert (done.exit_code, ward.chain.head.height) == (1, height), done.output
    assert load("en")["serve.unfinished.consent"] in done.output
    assert "It was left as it is" in done.output


def test_what_was_finished_in_time_is_not_called_unfinished(
    run: Run, ask_last: Callable[..., None], ward: SharedWard
) -> None:
    height = ward.chain.head.height
    ask_last("/api/consents/refuse", {"purposes": ["care"], "sensors": ["depth"]})
    done = run("--no-browser")
    assert done.exit_code == 0, done.output
    assert ward.chain.head.height > height
    assert not any(str(load("en")[f"serve.unfinished.{kind}"]) in done.output for kind in TOLD)
