"""What commands share: opening wallets, questions, warnings. The passphrase comes from the terminal or
BLOCKROBOT_PASSPHRASE_FILE.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Awaitable, Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import click

from clients.sdk.new_files import read_given_text
from clients.sdk.node_answers import FAULTY
from clients.sdk.terminal.terminal import (
    EXIT_FAILED,
    ask,
    can_ask,
    error_console,
    load_genesis,
)
from clients.wallet.cli.group_options import KEYRING_KEY
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.presentation.former_text import member_gone_line
from clients.wallet.presentation.invocation import with_command_prefix
from clients.wallet.presentation.translations import WrongUsage, text
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.passphrase_strength import PASSPHRASE_MIN_LETTERS, count_letters, judge_passphrase
from clients.wallet.store.system_keyring import read_from_keyring
from clients.wallet.store.wallet_lock import claim_wallet, lock_or_read_only, require_wallet
from clients.wallet.text_catalogue import refusal
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

_READS_ONLY_MARK = "blockrobot_reads_only"
PASSPHRASE_TRIES_MAX_COUNT = 5
_PASSPHRASE_FILE = "BLOCKROBOT_PASSPHRASE_FILE"  # noqa: S105 - the name of a variable, not a passphrase


def read_only_wallet(command: F) -> F:
    """Mark a command as safe while another program runs; its wallet changes are dropped, so the chain must have them."""
    setattr(command, _READS_ONLY_MARK, True)
    return command


@contextlib.contextmanager
def on_abort(ctx: click.Context, say: Callable[[], str]) -> Iterator[None]:
    """On Ctrl-C or a no, report what was done."""
    try:
        yield
    except (click.Abort, KeyboardInterrupt):
        if not (said := say()):
            raise
        click.echo("\n" + said, err=True)
        ctx.exit(EXIT_FAILED)


def read_passphrase(*, from_keyring: bool = True) -> str:
    """From file or terminal, or the keyring with `--keyring`."""
    context = click.get_current_context(silent=True)
    if from_keyring and context is not None and context.meta.get(KEYRING_KEY):
        return read_from_keyring(context.obj[0])
    given = _passphrase_from_file()
    return _ask_hidden("ask.passphrase") if given is None else given


def read_new_passphrase() -> str:
    """Return a new passphrase; at the terminal ask twice, five attempts. Raises PASSPHRASE_WEAK,
    PASSPHRASE_UNCONFIRMED.
    """
    given = _passphrase_from_file()
    if given is not None:
        judge_passphrase(given)
        return given
    click.echo(text("passphrase.wanted", count=PASSPHRASE_MIN_LETTERS), err=True)
    refusal = BlockRobotError("PASSPHRASE_UNCONFIRMED")
    for _ in range(PASSPHRASE_TRIES_MAX_COUNT):
        passphrase = _ask_hidden("ask.passphrase")
        try:
            strength = judge_passphrase(passphrase)
        except BlockRobotError as error:
            count = count_letters(passphrase)
            key = "passphrase.short" if count < PASSPHRASE_MIN_LETTERS else "passphrase.common"
            click.echo(text(key, count=count), err=True)
            refusal = error
            continue
        if _ask_hidden("ask.passphrase_again") == passphrase:
            click.echo(text(f"passphrase.{strength.value}"), err=True)
            return passphrase
        click.echo(text("passphrase.different"), err=True)
        refusal = BlockRobotError("PASSPHRASE_UNCONFIRMED")
    raise refusal


def _passphrase_from_file() -> str | None:
    path = os.environ.get(_PASSPHRASE_FILE)
    if path:
        return read_given_text(Path(path)).rstrip("\n")
    if not can_ask():
        raise WrongUsage("no_terminal_passphrase", variable=_PASSPHRASE_FILE)
    return None


def _ask_hidden(key: str) -> str:
    return str(click.prompt(text(key), hide_input=True, default="", show_default=False))


def require_new(out: Path | None) -> None:
    """Raise FILE_EXISTS for anything, including dangling links."""
    if out is not None and (out.exists() or out.is_symlink()):
        raise refusal("FILE_EXISTS", "file_kept", path=str(out))


def run_with_wallet(ctx: click.Context, action: Callable[[Wallet], Awaitable[T]]) -> T:
    """Read-only commands run while another program has the wallet, without saving. Warns if membership ended."""
    path, genesis_path = ctx.obj
    require_wallet(path)
    genesis = load_genesis(genesis_path)
    passphrase = read_passphrase()
    if getattr(ctx.command.callback, _READS_ONLY_MARK, False):
        with lock_or_read_only(path, name_command=with_command_prefix) as busy:
            store = Keystore.open(path, passphrase)
            if busy is not None:
                store.read_only()
                click.echo(text("ask.read_beside", who=busy.detail), err=True)
            return _run(store, genesis, action)
    with claim_wallet(path, name_command=with_command_prefix):
        return _run(Keystore.open(path, passphrase), genesis, action)


def run_made(store: Keystore, genesis_path: Path, action: Callable[[Wallet], Awaitable[T]]) -> T:
    """Raises GENESIS_INVALID."""
    return _run(store, load_genesis(genesis_path), action)


def _run(store: Keystore, genesis: Genesis, action: Callable[[Wallet], Awaitable[T]]) -> T:
    async def main() -> T:
        async with Wallet(store, genesis) as opened:
            opened.tell_scanned = print_scanned
            try:
                return await action(opened)
            finally:
                print_member_gone(opened)
                print_failed_nodes(opened.network.troubles)

    return asyncio.run(main())


def print_scanned(done: int, of: int) -> None:
    """On standard error, where a status line that is shown moves out of its way."""
    click.echo(text("ask.scanned", number=done, count=of), err=True)


def print_failed_nodes(troubles: Mapping[str, BlockRobotError]) -> None:
    """Nodes with false proofs, on standard error."""
    for name, error in sorted(troubles.items()):
        if error.code in FAULTY:
            click.echo(text("ask.lied", name=name, code=error.code), err=True)


def print_member_gone(opened: Wallet) -> None:
    for line in member_gone_line(opened):
        error_console.print(text("former.warning", line=line), style="bold red", markup=False)


def confirm_or_print(question: str, *, yes: bool, as_json: bool = False, explanation: str = "") -> None:
    """Announce `explanation` and ask, unless `yes`. Uses standard error beside JSON. Raises Abort, or UsageError without
    terminal.
    """
    if yes:
        return
    if not can_ask():
        raise WrongUsage("no_terminal_yes")
    if explanation:
        click.echo(explanation, err=True)
    ask(question, err=as_json or bool(explanation))


def warn_of_linked_visits(entries: list[RecordEntry], *, as_json: bool) -> list[RecordEntry]:
    """Return the records unchanged."""
    if not as_json:
        print_linking_notice(len({entry.visit.owner for entry in entries}))
    return entries


def print_linking_notice(visit_count: int) -> None:
    if visit_count > 1:
        click.echo(text("linked.acting", number=visit_count), err=True)


def print_linked_moves(visit_count: int, *, with_member: bool) -> None:
    """Of visits rotated together; `with_member`: with the member too."""
    if not visit_count or (visit_count == 1 and not with_member):
        return
    key = "linked.moving_member" if with_member else "linked.moving"
    notice = text(key, count=visit_count, number=visit_count)
    click.echo(f"{notice} {text('linked.otherwise')}", err=True)
