"""`blockrobot wallet serve`: the wallet as a local web page. Opened by a private one-time file; ends when stopped,
locked or idle, dropping the keys.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import click

from clients.sdk.terminal.json_answers import Problem
from clients.sdk.terminal.terminal import (
    EXIT_FAILED,
    can_ask,
    command_output,
    console,
    load_genesis,
    print_answer,
    problem_json,
)
from clients.wallet.answers.wallet_answers import ServeAnswer, ServeEndAnswer, UnfinishedRequest
from clients.wallet.cli.wallet_context import print_member_gone, read_passphrase
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.page.jobs import DECISIONS
from clients.wallet.page.page import make_page, page_folder
from clients.wallet.page.passphrase_check import ATTEMPTS_MAX_COUNT
from clients.wallet.page.session import PageSession
from clients.wallet.presentation.invocation import called, with_command_prefix
from clients.wallet.presentation.translations import error_text, text
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.wallet_lock import claim_wallet, require_wallet
from pages.local_page import LocalPage
from pages.opening import open_in_browser

IDLE_DEFAULT_MINUTES = 30
IDLE_MAX_MINUTES = 24 * 60
_LOOK_S = 1.0
ENDINGS = (signal.SIGINT, signal.SIGTERM)


@click.command()
@click.option("--no-browser", is_flag=True, help="Do not open a browser; print which file opens the page.")
@click.option(
    "--idle-minutes",
    type=click.IntRange(1, IDLE_MAX_MINUTES),
    default=IDLE_DEFAULT_MINUTES,
    show_default=True,
    help="End after so long without use.",
)
@click.pass_context
@command_output
def serve(ctx: click.Context, no_browser: bool, idle_minutes: int, as_json: bool) -> None:
    """Open your wallet as a page in your browser, for you alone: it is served on this machine, and keys stay here.

    It ends with Ctrl-C, with Lock on the page, or when nobody has used it for a while.

    Example: blockrobot wallet serve
    """
    path, genesis_path = ctx.obj
    require_wallet(path)
    genesis = load_genesis(genesis_path)
    command = f"{called()} serve"
    passphrase = read_passphrase()
    with claim_wallet(path, name_command=with_command_prefix):
        store = Keystore.open(path, passphrase)
        wallet = Wallet(store, genesis)
        session = PageSession(wallet, path.stem, page_folder(path), command=command)
        try:
            why = asyncio.run(_serve(wallet, session, idle_minutes, no_browser=no_browser, as_json=as_json))
            if not as_json:
                console.print(why)
        finally:
            _print_unfinished(session, as_json=as_json)
    if session.unfinished or session.was_not_begun:
        ctx.exit(EXIT_FAILED)


def _print_unfinished(session: PageSession, *, as_json: bool) -> None:
    if as_json and (session.unfinished or session.was_not_begun):
        requests = [
            UnfinishedRequest(kind=kind, error=None if error is None else Problem(**problem_json(error)))
            for kind, error in session.unfinished
        ]
        print_answer(ServeEndAnswer(unfinished=requests, not_begun=session.was_not_begun), ok=False)
        return
    for kind, error in session.unfinished:
        is_left = error is None and kind in DECISIONS
        click.echo("\n" + text(f"serve.unfinished.{kind}"), err=True)
        if error is not None:
            click.echo(error_text(error), err=True)
        click.echo(text("serve.left" if is_left else "serve.again", command=session.command), err=True)


async def _serve(wallet: Wallet, session: PageSession, idle_minutes: int, *, no_browser: bool, as_json: bool) -> str:
    """Return the reason of the end."""
    async with wallet as opened, session:
        with_endings = _end_in_order(session)
        page = make_page(session)
        try:
            where = await page.start()
            _tell(where.url, where.redirect_file, no_browser=no_browser, as_json=as_json)
            _offer_links(page, as_json=as_json)
            why = await _wait_until_over(session, idle_minutes)
            session.jobs.begin_to_end()
            if (session.gate.is_asked or session.jobs.are_decisions_open) and not as_json:
                console.print(text("serve.finishing"))
            if session.gate.is_asked:
                with_endings()
                await _let_begin(session, as_json=as_json)
            return why
        finally:
            await page.stop()
            with_endings()
            print_member_gone(opened)


async def _let_begin(session: PageSession, *, as_json: bool) -> None:
    session.was_not_begun = True
    try:
        session.was_not_begun = not await session.gate.finish_checks()
    finally:
        if session.was_not_begun and not as_json:
            console.print(text("serve.not_begun", command=session.command))


def _tell(url: str, file: Path, *, no_browser: bool, as_json: bool) -> None:
    """The URL alone gives no access."""
    opened = not no_browser and open_in_browser(file)
    if as_json:
        print_answer(ServeAnswer(url=url, redirect_file=str(file), browser_opened=opened))
        sys.stdout.flush()
        return
    if opened:
        console.print(text("serve.opened", url=url, file=file))
    else:
        console.print(text("serve.open_it", file=file))
    console.print(text("serve.keep"))


def _offer_links(page: LocalPage, *, as_json: bool) -> None:
    if as_json or not can_ask():
        return
    making: set[asyncio.Task[None]] = set()

    async def offer() -> None:
        console.print(text("serve.new_link", file=await page.new_link()))

    def heard() -> None:
        if not sys.stdin.readline():
            asyncio.get_running_loop().remove_reader(sys.stdin)
            return
        task = asyncio.create_task(offer())
        making.add(task)
        task.add_done_callback(making.discard)

    asyncio.get_running_loop().add_reader(sys.stdin, heard)


def _end_in_order(session: PageSession) -> Callable[[], None]:
    """At Ctrl-C and SIGTERM; return the undo function."""
    loop = asyncio.get_running_loop()
    for number in ENDINGS:
        loop.add_signal_handler(number, session.ended.set)

    def undo() -> None:
        for number in ENDINGS:
            loop.remove_signal_handler(number)

    return undo


async def _wait_until_over(session: PageSession, idle_minutes: int) -> str:
    while True:
        try:
            async with asyncio.timeout(_LOOK_S):
                await session.ended.wait()
        except TimeoutError:
            if not session.is_idle(idle_minutes):
                continue
            return text("serve.idle", count=idle_minutes)
        if session.was_given_up:
            return text("serve.given_up", tries=ATTEMPTS_MAX_COUNT)
        return text("serve.closed")
