"""`blockrobot wallet guardians recover|check`: rebuild a wallet from guardians' shares."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
from msgspec import UNSET
from shamir_mnemonic import Share

from clients.sdk.new_files import read_given_text
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import (
    EXISTING_FILE,
    EXIT_FAILED,
    FILE,
    ask,
    ask_for,
    can_ask,
    clear_screen,
    command_output,
    console,
    is_at_terminal,
    print_answer,
    status_line,
)
from clients.wallet.answers.guardian_answers import GuardiansCheckAnswer, GuardianShare, GuardiansRecoverAnswer
from clients.wallet.cli.mnemonic_handover import print_words, word_lines, write_words
from clients.wallet.cli.wallet_context import read_new_passphrase, run_made
from clients.wallet.commands.account.new_commands import guess_cost
from clients.wallet.commands.account.wallet_restore import CHECK_MAX_S, read_words, require_distinct, restore_wallet
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.guardian_sheets import SHEET_MAX_BYTES, extract_share_text, read_written
from clients.wallet.presentation.invocation import with_command_prefix
from clients.wallet.presentation.translations import WrongUsage, error_text, text
from clients.wallet.recovery.slip39_shares import (
    SHARE_WORDS_COUNT,
    ShareCollector,
    find_unknown,
    near_words,
    read_share,
    require_of_wallet,
    show_identifier,
    tokenize_words,
)
from clients.wallet.store.keystore import GuardianSet, Keystore
from clients.wallet.store.member_keys import derive_keys
from clients.wallet.store.wallet_lock import claim_place
from consensus.errors import BlockRobotError
from consensus.visible_text import printable

MEMBER, NOBODY, NOT_ASKED = "member", "nobody", "not_asked"
"""What the network says of the words: a registered member's, nobody's (yet, or any more), or it did not answer."""
_STDIN = Path("-")


def _print_unknown(number: int, word: str) -> None:
    near = near_words(word)
    shown = printable(word, SHARE_WORDS_COUNT)
    if near:
        click.echo(text("guardians.unknown", number=number, word=shown, near=", ".join(near)))
    else:
        click.echo(text("guardians.unknown_bare", number=number, word=shown))


def _type_words() -> list[str]:
    words: list[str] = []
    while len(words) < SHARE_WORDS_COUNT:
        typed = tokenize_words(ask_for(text("guardians.word", number=len(words) + 1)))
        unknown = find_unknown(typed)
        words += typed[:unknown]
        if unknown is not None:
            _print_unknown(len(words) + 1, typed[unknown])
    return words


def type_share() -> Share:
    """Allows corrections. Raises Abort at Ctrl-C."""
    words = _type_words()
    while True:
        share = None
        try:
            share = read_share(" ".join(words))
            require_of_wallet(share)
            return share
        except BlockRobotError as error:
            if share is not None or len(words) != SHARE_WORDS_COUNT:
                click.echo(error_text(error), err=True)
                words = _type_words()
                continue
        console.print(text("guardians.not_whole"))
        for line in word_lines(" ".join(words), console.width):
            console.print(line)
        wanted = ask_for(text("guardians.correct")).strip()
        number = int(wanted) if wanted.isdecimal() and int(wanted) <= SHARE_WORDS_COUNT else None
        if number == 0:
            words = _type_words()
        elif number is not None:
            (word, *_) = tokenize_words(ask_for(text("guardians.correct_word", number=number))) or [""]
            if find_unknown([word]) is None:
                words[number - 1] = word
            else:
                _print_unknown(number, word)


def _read_file(path: Path, *, as_json: bool) -> Share:
    try:
        written = extract_share_text(sys.stdin.read(SHEET_MAX_BYTES)) if path == _STDIN else read_written(path)
        share = read_share(written)
        require_of_wallet(share)
    except BlockRobotError as error:
        if error.code == "SHARE_WORD_UNKNOWN" and not as_json and console.is_terminal:
            place = int(error.context["number"])
            _print_unknown(place, tokenize_words(written)[place - 1])
        raise BlockRobotError(error.code, f"{path.name}: {error.detail}", **error.context) from None
    return share


@click.command()
@click.argument(
    "file", type=click.Path(path_type=Path, exists=True, dir_okay=False, allow_dash=True), default=str(_STDIN)
)
@command_output
def check(file: Path, as_json: bool) -> None:
    """For guardians: see that your words are whole. Needs no wallet and no other guardian, and keeps nothing.

    FILE is a sheet or a text; without it, or with -, the words are typed.

    Example: blockrobot wallet guardians check
    """
    if file == _STDIN and can_ask() and not as_json:
        if not is_at_terminal():
            raise WrongUsage("no_terminal_typed")
        console.print(text("guardians.type", words=SHARE_WORDS_COUNT))
        try:
            share = type_share()
        finally:
            clear_screen()
    else:
        share = _read_file(file, as_json=as_json)
    if as_json:
        number = share.index + 1
        print_answer(GuardiansCheckAnswer(identifier=share.identifier, sheet=number, threshold=share.member_threshold))
        return
    _print_complete(share)
    console.print(text("guardians.checked", threshold=share.member_threshold))


def _print_complete(share: Share) -> None:
    identifier = show_identifier(share.identifier)
    console.print(text("guardians.whole", number=share.index + 1, identifier=identifier))


def _print_progress(gathering: ShareCollector) -> None:
    if gathering.last is not None:
        _print_complete(gathering.last)
    if gathering.is_complete:
        return
    if gathering.needed:
        console.print(text("guardians.needed", count=gathering.needed))
    further = gathering.groups_needed - (1 if gathering.needed else 0)
    if further > 0:
        console.print(text("guardians.groups_needed", count=further))


def _gather_typed(gathering: ShareCollector) -> None:
    """Inconsistent ones are kept, since others may be wrong."""
    is_first = gathering.last is None
    console.print(text("guardians.type", words=SHARE_WORDS_COUNT) if is_first else text("guardians.type_next"))
    try:
        share = type_share()
    finally:
        clear_screen()
    try:
        _print_difference(gathering.add(share))
    except BlockRobotError as error:
        click.echo(error_text(error), err=True)
        return
    _print_progress(gathering)


def _print_difference(difference: BlockRobotError | None) -> None:
    if difference is not None:
        click.echo(error_text(difference), err=True)
        click.echo(text("guardians.kept"), err=True)


def _sheets(shares: Sequence[Share]) -> str:
    return ", ".join(
        text("guardians.sheet", number=share.index + 1, identifier=show_identifier(share.identifier))
        for share in shares
    )


def _print_joined(gathering: ShareCollector, *, may_ask: bool) -> None:
    console.print(text("guardians.enough"))
    left_out = gathering.misfits()
    if left_out:
        threshold = gathering.joined[0].member_threshold
        click.echo(text("guardians.left_out", left=_sheets(left_out), used=_sheets(gathering.joined)), err=True)
        click.echo(text("guardians.said", threshold=threshold), err=True)
        if may_ask:
            ask(text("guardians.go_on"))


def _gather(files: tuple[Path, ...], *, as_json: bool) -> tuple[ShareCollector, str]:
    """Until they yield 24 words. Raises SHARES_TOO_FEW and file errors."""
    may_ask = is_at_terminal() and not as_json
    gathering = ShareCollector()
    for file in files:
        share = _read_file(file, as_json=as_json)
        try:
            difference = gathering.add(share)
        except BlockRobotError as error:
            raise BlockRobotError(error.code, f"{file.name}: {error.detail}") from None
        if not as_json:
            _print_difference(difference)
            _print_progress(gathering)
    while True:
        try:
            with status_line(text("guardians.joining"), as_json=as_json or not gathering.is_complete):
                return gathering, gathering.join()
        except BlockRobotError as error:
            if not may_ask:
                detail = (
                    f"{gathering.needed} more of this set needed." if error.code == "SHARES_TOO_FEW" else error.detail
                )
                raise BlockRobotError(error.code, detail) from None
            if gathering.is_complete:
                click.echo(error_text(error), err=True)
        _gather_typed(gathering)


def _ask_network(path: Path, passphrase: str, genesis_path: Path, gathering: ShareCollector) -> str:
    store = Keystore.open(path, passphrase)
    share = gathering.joined[0]
    made = GuardianSet(0, share.member_threshold, [], share.identifier, len(store.content.former))
    store.content.guardian_sets.append(made)
    store.save()

    async def ask(opened: Wallet) -> str:
        async with asyncio.timeout(CHECK_MAX_S):
            await opened.require_registered()
        return MEMBER

    try:
        return run_made(store, genesis_path, ask)
    except TimeoutError:
        return NOT_ASKED
    except BlockRobotError as error:
        return NOBODY if error.code == "NOT_REGISTERED" else NOT_ASKED


def _require_possible(
    files: tuple[Path, ...], words_file: Path | None, *, only: bool, show: bool, as_json: bool
) -> None:
    at_terminal = is_at_terminal()
    if not files and (as_json or not at_terminal):
        raise WrongUsage("no_terminal_shares")
    if show and (as_json or not at_terminal):
        raise WrongUsage("no_terminal_show")
    if words_file is not None and words_file.exists():
        raise WrongUsage("file_there", path=words_file)
    if words_file is not None and not os.access(words_file.parent, os.W_OK | os.X_OK):
        raise WrongUsage("no_folder", folder=words_file.parent)
    if only and words_file is None and not show:
        raise WrongUsage("words_where")


@contextlib.contextmanager
def _place(ctx: click.Context, path: Path, words_file: Path | None) -> Iterator[None]:
    """Reserve the new wallet's place; on failure report leftovers. A written words file stays."""
    with claim_place(path, name_command=with_command_prefix):
        try:
            yield
        except BaseException as ending:
            has_words = words_file is not None and words_file.exists()
            is_stopped = isinstance(ending, click.Abort | KeyboardInterrupt)
            if path.exists():
                key = "new.stopped_words" if has_words else "new.stopped_made"
                click.echo("\n" + text(key, path=path, words_file=words_file), err=True)
            elif has_words:
                click.echo("\n" + text("guardians.words_left", words_file=words_file), err=True)
            elif is_stopped:
                click.echo("\n" + text("guardians.none_made"), err=True)
            if is_stopped:
                ctx.exit(EXIT_FAILED)
            raise


@click.command()
@click.option(
    "--share",
    "files",
    type=EXISTING_FILE,
    multiple=True,
    help="A guardian's sheet, or words as text; may be repeated. The rest is asked for.",
)
@click.option(
    "--former",
    type=EXISTING_FILE,
    multiple=True,
    help="Words that were replaced, in a file; oldest first if there are several.",
)
@click.option("--words-file", type=FILE, help="Write the 24 words too, mode 0600.")
@click.option("--show-words", "show", is_flag=True, help="Show the 24 words too, to write them down again.")
@click.option("--words-only", "only", is_flag=True, help="Make no wallet: for words that were replaced (--former).")
@click.option("--fast-passphrase", is_flag=True, help="A cheaper passphrase check, for tests and demonstrations.")
@click.pass_context
@command_output
def recover(
    ctx: click.Context,
    files: tuple[Path, ...],
    former: tuple[Path, ...],
    words_file: Path | None,
    show: bool,
    only: bool,
    fast_passphrase: bool,
    as_json: bool,
) -> None:
    """Make a lost wallet again from the words of enough guardians. It has the same 24 words as before.

    Says after each guardian how many more are needed. A wrong word, another set and the same guardian twice are told.

    Example: blockrobot wallet guardians recover
    """
    path, genesis_path = ctx.obj
    _require_possible(files, words_file, only=only, show=show, as_json=as_json)
    member, membership, known = "", "", False
    with contextlib.nullcontext() if only else _place(ctx, path, words_file):
        replaced = [read_words(read_given_text(file)) for file in former]
        gathering, words = _gather(files, as_json=as_json)
        require_distinct(words, replaced)
        if not as_json:
            _print_joined(gathering, may_ask=is_at_terminal())
        if not only:
            passphrase = read_new_passphrase()
        if words_file is not None:
            write_words(words_file, words)
        if not only:
            known = restore_wallet(path, words, replaced, passphrase, guess_cost(fast_passphrase), genesis_path)
            member = derive_keys(words).identity.public_key.hex()
            membership = _ask_network(path, passphrase, genesis_path, gathering)
    if as_json:
        answer = GuardiansRecoverAnswer(
            wallet=UNSET if only else str(path),
            member=UNSET if only else member,
            words_checked=UNSET if only else known,
            membership=UNSET if only else membership,
            words_file=str(words_file) if words_file else None,
            left_out=[GuardianShare(identifier=each.identifier, sheet=each.index + 1) for each in gathering.misfits()],
        )
        print_answer(answer)
        return
    if words_file is not None:
        console.print(text("guardians.words_file", path=escape(str(words_file))))
    if show:
        print_words(text("new.words"), words)
    if not only:
        _print_recovered(path, membership, has_former=bool(former))


def _print_recovered(path: Path, membership: str, *, has_former: bool) -> None:
    console.print(text("guardians.recovered", path=escape(str(path))))
    if membership == MEMBER:
        console.print(text("guardians.member"))
    elif membership == NOBODY:
        console.print(text("guardians.nobody"))
    else:
        console.print(text("guardians.not_asked"))
    if not has_former:
        console.print(text("restore.former"))
