"""`blockrobot wallet erase` and `erasures`: explain, confirm and request erasure, and show what became of it."""

from __future__ import annotations

import functools
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import click
from msgspec import UNSET

from clients.sdk.terminal.json_answers import Problem
from clients.sdk.terminal.terminal import ask, can_ask, command_output, console, print_answer, problem_json
from clients.wallet.answers.record_answers import ErasuresAnswer
from clients.wallet.answers.sharing_answers import EraseAnswer, ErasureRequest
from clients.wallet.cli.group_options import complete_records, visit_option
from clients.wallet.cli.wallet_context import read_only_wallet, run_with_wallet, warn_of_linked_visits
from clients.wallet.commands.share_commands import print_copies, print_recipients
from clients.wallet.ledger.record_filter import choose_records
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.erasure_text import custodian_names, erasure_lines, erasure_row
from clients.wallet.presentation.share_text import own_share
from clients.wallet.presentation.translations import WrongUsage, language_in_use, text
from clients.wallet.records.erasure import WAIT_MAX_S, ErasureClient, ErasurePlan, ErasureReport
from clients.wallet.records.erasure_status import ErasureProgress, find_erasures
from clients.wallet.records.viewing import name_places
from clients.wallet.sharing.outgoing_shares import Share, SharingClient
from clients.wallet.text_catalogue import DEFAULT_LANGUAGE
from consensus.errors import BlockRobotError
from consensus.exit_codes import exit_code_of
from pages.time_format import format_time

_NUMBER = re.compile(r"[1-9][0-9]{0,8}", re.ASCII)


@dataclass(frozen=True, slots=True)
class _EraseOptions:
    """Parsed options; no `record_ids` and `visits`: all records, empty `frames` (indexes): whole records."""

    record_ids: tuple[str, ...]
    visits: tuple[str, ...]
    frames: list[int]
    wait: bool
    yes: bool
    as_json: bool


@dataclass(slots=True)
class _EraseResult:
    """Result; `left_out` are picture indexes already gone, `late` why waiting failed."""

    reports: list[ErasureReport] = field(default_factory=list)
    recipients: list[Share] = field(default_factory=list)
    left_out: list[int] = field(default_factory=list)
    late: BlockRobotError | None = None


def _read_frames(written: str | None) -> list[int]:
    """Indexes of numbers from 1. Raises WrongUsage: an empty selection would mean the whole record."""
    if written is None:
        return []
    numbers = [part.strip(" ") for part in written.split(",")]
    if not all(_NUMBER.fullmatch(number) for number in numbers):
        raise WrongUsage("frames")
    return sorted({int(number) - 1 for number in numbers})


def _require_pictures(plan: ErasurePlan) -> None:
    """Raises WrongUsage."""
    if plan.missing and not plan.count:
        raise WrongUsage("no_picture_at_all")
    if plan.missing:
        raise WrongUsage("no_picture", missing=name_places(plan.missing), count=plan.count)


def _ask_to_erase(plan: ErasurePlan, recipients: Sequence[Share]) -> None:
    """Raises Abort."""
    entries, frames = plan.entries, plan.frames
    if frames:
        (entry,) = entries
        times = {
            "first": format_time(entry.metadata.started_at_ms),
            "last": format_time(entry.metadata.ended_at_ms),
        }
        name, numbers = entry.record_id.hex()[:12], name_places(frames)
        console.print(text("erase.frames", count=len(frames), numbers=numbers, of=plan.count, name=name, **times))
    else:
        pictures = text("records.pictures", count=sum(entry.pictures_left_count for entry in entries))
        visits = text("count.visits", count=len({entry.visit.owner for entry in entries}))
        console.print(text("erase.records", count=len(entries), visits=visits, pictures=pictures))
    if recipients:
        console.print(text("page.erase.gone2Part" if frames else "page.erase.gone2"))
        console.print(text("page.erase.recipients") + ":")
        print_recipients(recipients)
    console.print(text("erase.remains"))
    ask(text("erase.ask"))


def _ignore(_: Sequence[ErasureReport]) -> None: ...


def _show_receipts() -> Callable[[Sequence[ErasureReport]], None]:
    shown: list[int] = []

    def show(reports: Sequence[ErasureReport]) -> None:
        here = sum(len(report.state.receipts) for report in reports)
        if here and shown[-1:] != [here]:
            shown.append(here)
            of_all = sum(len(report.state.custodians) for report in reports)
            click.echo(text("erase.receipts", here=here, count=of_all), err=True)

    return show


@click.command()
@click.argument("record_ids", nargs=-1, shell_complete=complete_records)
@visit_option
@click.option("--all", "everything", is_flag=True, help="Erase all records of all visits.")
@click.option("--frames", help="Only these pictures of one record, counted from 1: 1,4,5. Files in exports: from 0.")
@click.option("--wait", is_flag=True, help="Wait until every custodian has confirmed.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def erase(
    ctx: click.Context,
    record_ids: tuple[str, ...],
    visits: tuple[str, ...],
    everything: bool,
    frames: str | None,
    wait: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Erase records, or single pictures of one. Keys are destroyed first; this cannot be undone.

    Example: blockrobot wallet erase 3fa2c19b07de --frames 1,4 --wait
    """
    if not record_ids and not visits and not everything:
        raise WrongUsage("erase_what")
    frame_indexes = _read_frames(frames)
    if frame_indexes and (everything or visits or len(record_ids) != 1):
        raise WrongUsage("frames_of_one")
    if not yes and not can_ask():
        raise WrongUsage("no_terminal_yes")
    if everything:
        record_ids, visits = (), ()
    wish = _EraseOptions(record_ids, visits, frame_indexes, wait, yes, as_json)
    done = run_with_wallet(ctx, functools.partial(_erase, wish))
    if as_json:
        print_answer(_erase_answer(done), ok=done.late is None)
    else:
        _print_done(done, is_told=not yes)
    if done.late is None:
        return
    if as_json:
        ctx.exit(exit_code_of(done.late.entry))
    raise done.late


async def _erase(wish: _EraseOptions, opened: Wallet) -> _EraseResult:
    """Raises Abort, WrongUsage."""
    erasing, done = ErasureClient(opened), _EraseResult()
    plan = await erasing.plan(await choose_records(opened, wish.record_ids, wish.visits), wish.frames)
    _require_pictures(plan)
    done.left_out = plan.gone
    if plan.gone and not wish.as_json:
        console.print(text("erase.left_out", numbers=name_places(plan.gone), count=len(plan.gone)))
    if plan.is_empty:
        return done
    warn_of_linked_visits(plan.entries, as_json=wish.as_json)
    done.recipients = await SharingClient(opened).recipients(plan.entries)
    if not wish.yes:
        _ask_to_erase(plan, done.recipients)
    requested = await erasing.request_each(plan.entries, plan.frames)
    try:
        if wish.wait:
            show = _ignore if wish.as_json else _show_receipts()
            await erasing.wait_complete(requested, WAIT_MAX_S, show)
    except BlockRobotError as error:
        if error.code != "ERASURE_NOT_CONFIRMED":
            raise
        done.late = error  # who had received it is shown all the same
    done.reports = [await erasing.report(visit, erasure_id) for visit, ids in requested for erasure_id in ids]
    return done


def _erase_answer(done: _EraseResult) -> EraseAnswer:
    now_ms = time.time_ns() // 1_000_000
    return EraseAnswer(
        error=UNSET if done.late is None else Problem(**problem_json(done.late)),
        erasures=[
            ErasureRequest(
                erasure_id=report.erasure_id.hex(),
                status=report.state.status,
                custodians=[custodian.hex() for custodian in report.state.custodians],
                confirmed=[custodian.hex() for custodian in report.state.receipts],
            )
            for report in done.reports
        ],
        left_out_numbers=[index + 1 for index in done.left_out],
        recipients=[own_share(each, now_ms) for each in done.recipients],
    )


def _print_done(done: _EraseResult, *, is_told: bool) -> None:
    if not done.reports:
        console.print(text("erase.nothing"))
    for report in done.reports:
        name, status = report.erasure_id.hex()[:16], text("erase.complete" if report.complete else "erase.requested")
        confirmed, count = len(report.state.receipts), len(report.state.custodians)
        console.print(text("erase.report", name=name, status=status, confirmed=confirmed, count=count))
    if not is_told:
        print_recipients(done.recipients)
    print_copies(done.recipients)


@click.command()
@click.pass_context
@command_output
@read_only_wallet
def erasures(ctx: click.Context, as_json: bool) -> None:
    """Show what you asked to erase, which custodians have confirmed it, and which are overdue.

    Example: blockrobot wallet erasures
    """

    async def action(opened: Wallet) -> tuple[list[ErasureProgress], dict[bytes, str]]:
        found = await find_erasures(opened, time.time_ns() // 1_000_000)
        return found, custodian_names(opened, DEFAULT_LANGUAGE if as_json else language_in_use())

    found, names = run_with_wallet(ctx, action)
    if as_json:
        print_answer(ErasuresAnswer(erasures=[erasure_row(each, names) for each in found]))
        return
    if not found:
        console.print(text("erasures.none"))
    for each in found:
        for line in erasure_lines(each, names):
            console.print(line)
