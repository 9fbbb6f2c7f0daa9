"""`blockrobot wallet share|shares|revoke|handle`: the owner's side of sharing."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence

import click

from clients.sdk.terminal.qr_codes import read_given
from clients.sdk.terminal.terminal import command_output, console, print_answer, status_line
from clients.wallet.answers.sharing_answers import (
    HandleAnswer,
    RevokeAnswer,
    ShareAnswer,
    SharesAnswer,
)
from clients.wallet.cli.group_options import visit_option
from clients.wallet.cli.times import read_time
from clients.wallet.cli.wallet_context import confirm_or_print, read_only_wallet, run_with_wallet
from clients.wallet.ledger.record_filter import refuse_erased
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.share_text import (
    explain,
    extend_with_grants,
    made_share,
    name_grantee,
    name_recipient,
    own_share,
    role_text,
    share_lines,
)
from clients.wallet.presentation.translations import WrongUsage, language_in_use, text
from clients.wallet.records.rights_requests import choose
from clients.wallet.sharing.chain_grants import resolve_grant
from clients.wallet.sharing.outgoing_shares import (
    STEP_KEYS,
    STEP_PARTS,
    STEP_SIGNING,
    FinalGrant,
    Grantee,
    OnProgress,
    Share,
    SharingClient,
    place_end,
    require_purpose_to_share,
    select_shareable,
    share_each,
)
from clients.wallet.text_catalogue import DEFAULT_LANGUAGE
from consensus.members.handles import encode_short
from consensus.records.sharing import GRANTEE_ROLES
from pages.time_format import format_time, parse_duration

_STEPS = {STEP_KEYS: "share.keys", STEP_SIGNING: "share.signing"}


def read_end(span: str | None, until: str | None, now_ms: int) -> int:
    """In ms: after a duration (7d, 12h), or at a time."""
    if span is not None and until is not None:
        raise WrongUsage("end_twice")
    if until is not None:
        return place_end(read_time(until, now_ms), now_ms)
    if span is None:
        raise WrongUsage("how_long")
    try:
        return place_end(now_ms + parse_duration(span), now_ms)
    except ValueError:
        raise WrongUsage("span") from None


def step_text(step: str) -> str:
    if step.startswith(STEP_PARTS):
        return text("share.parts", name=step.removeprefix(STEP_PARTS))
    return text(_STEPS[step])


def _show_step(show: OnProgress, step: str) -> None:
    show(step_text(step))


def _print_shared(shared: FinalGrant, grantee: Grantee) -> None:
    console.print(
        text(
            "share.done",
            grantee=name_grantee(grantee),
            records=text("count.records", count=len(shared.records)),
            until=format_time(shared.until_ms),
            grant=shared.grant_id.hex()[:12],
        )
    )
    if shared.left_out:
        console.print("  " + text("share.left_out", count=len(shared.left_out)))
    if shared.absent:
        away = text("share.away", names=", ".join(shared.absent), count=len(shared.absent))
        console.print(f"  [yellow]{away}[/yellow]")
    if len(shared.custodians) == 1 and not shared.absent:
        console.print(f"  [yellow]{text('share.one_custodian')}[/yellow]")


@click.command()
@click.argument("record_ids", nargs=-1)
@visit_option
@click.option(
    "--with", "wanted", required=True, help="The other's handle (or @FILE), or a name under which you shared before."
)
@click.option("--as", "label", default="", help="What you call the other; it stays in your wallet.")
@click.option("--purpose", required=True, help="What for: a purpose's code.")
@click.option("--for", "span", help="For how long: 90m, 12h, 7d, 2w.")
@click.option("--until", help="Until when: +7d, 2027-01-31 or 2027-01-31T18:00.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def share(
    ctx: click.Context,
    record_ids: tuple[str, ...],
    visits: tuple[str, ...],
    wanted: str,
    label: str,
    purpose: str,
    span: str | None,
    until: str | None,
    yes: bool,
    as_json: bool,
) -> None:
    """Share records of one visit with a member of the staff or an officer, for a purpose and a time.

    The other reads the handle out to you (wallet handle). You are told what that means, and asked, before.

    Example: blockrobot wallet share --visit 02ab34cd --with HANDLE --as "Dr Weber" --purpose care --for 7d
    """
    if not record_ids and not visits:
        raise WrongUsage("name_records")
    until_ms = read_end(span, until, time.time_ns() // 1_000_000)

    async def action(opened: Wallet) -> tuple[Grantee, list[FinalGrant]]:
        require_purpose_to_share(purpose, opened.genesis.purposes)
        sharing = SharingClient(opened)
        grantee = await sharing.resolve_grantee(read_given(wanted), label)
        reports = await opened.records()
        await refuse_erased(opened, reports, record_ids)
        entries = select_shareable(reports, choose(reports, record_ids, visits), purpose)
        explanation = explain(entries, grantee, purpose, until_ms)
        confirm_or_print(text("share.ask"), yes=yes, explanation=explanation)
        with status_line(text("share.doing"), as_json=as_json) as show:
            language = DEFAULT_LANGUAGE if as_json else language_in_use()
            on_progress = functools.partial(_show_step, show)
            add_made = functools.partial(extend_with_grants, language=language)
            return grantee, await share_each(
                sharing, entries, grantee, purpose, until_ms, on_progress, explain=add_made
            )

    grantee, done = run_with_wallet(ctx, action)
    if as_json:
        rows, who = [made_share(shared) for shared in done], grantee.member
        print_answer(ShareAnswer(handle=who.handle.hex(), role=who.role, purpose=purpose, shared=rows))
        return
    for shared in done:
        _print_shared(shared, grantee)


@click.command()
@click.pass_context
@command_output
@read_only_wallet
def shares(ctx: click.Context, as_json: bool) -> None:
    """Show what you share, with whom, until when, who looked and when, and who says that copies are deleted.

    Example: blockrobot wallet shares
    """

    async def action(opened: Wallet) -> list[Share]:
        return await SharingClient(opened).shares()

    found, now_ms = run_with_wallet(ctx, action), time.time_ns() // 1_000_000
    if as_json:
        print_answer(SharesAnswer(shares=[own_share(each, now_ms) for each in found]))
        return
    if not found:
        console.print(text("shares.none"))
    for each in found:
        for line in share_lines(each, now_ms):
            console.print(line)
        if each.grant.row.is_open(now_ms) and each.left:
            console.print("  " + text("shares.to_end", grant=each.grant.grant_id.hex()[:12]))


def print_recipients(found: Sequence[Share]) -> None:
    """Of records to be erased (Art. 19)."""
    for each in found:
        moments = ", ".join(format_time(each_look.time_ms) for each_look in each.looks)
        if moments:
            console.print(text("shares.told_who_looked", name=name_recipient(each), moments=moments))
        else:
            console.print(text("shares.told_who_did_not", name=name_recipient(each)))


def print_copies(found: Sequence[Share]) -> None:
    if found:
        console.print("  " + text("shares.copies"))


@click.command()
@click.argument("grant")
@click.pass_context
@command_output
def revoke(ctx: click.Context, grant: str, as_json: bool) -> None:
    """End what you shared (GRANT: the beginning of its name, by `blockrobot wallet shares`). At once, and for good.

    Example: blockrobot wallet revoke 3fa2c19b07de
    """

    async def action(opened: Wallet) -> tuple[Share, bytes | None]:
        sharing = SharingClient(opened)
        found = await sharing.shares()
        chosen = resolve_grant([each.grant.grant_id for each in found], grant)
        (one,) = [each for each in found if each.grant.grant_id == chosen]
        return one, None if one.grant.row.status == "revoked" else await sharing.revoke(one)

    ended, txid = run_with_wallet(ctx, action)
    if as_json:
        answer = RevokeAnswer(
            grant_id=ended.grant.grant_id.hex(),
            txid=None if txid is None else txid.hex(),
            looks=len(ended.looks),
            already_ended=txid is None,
        )
        print_answer(answer)
        return
    if txid is None:
        console.print(text("revoke.already"))
    else:
        console.print(text("revoke.done", count=len(ended.grant.row.records), name=name_recipient(ended)))
    if ended.looks:
        console.print("  " + text("revoke.looked"))


@click.command()
@click.pass_context
@command_output
@read_only_wallet
def handle(ctx: click.Context, as_json: bool) -> None:
    """Show your own handle. Whoever is to share something with you needs it; it is no secret.

    Example: blockrobot wallet handle
    """

    async def action(opened: Wallet) -> tuple[bytes, str]:
        await opened.require_registered()
        return opened.store.content.handle, opened.store.content.role

    own, role = run_with_wallet(ctx, action)
    if as_json:
        print_answer(HandleAnswer(handle=own.hex(), short=encode_short(own), role=role))
        return
    digits = own.hex()
    console.print(encode_short(own))
    console.print("  " + " ".join(digits[start : start + 8] for start in range(0, len(digits), 8)))
    if role not in GRANTEE_ROLES:
        console.print("  " + text("handle.not_for", role=role_text(role)))
    else:
        console.print("  " + text("handle.tell"))


COMMANDS = (share, shares, revoke, handle)
