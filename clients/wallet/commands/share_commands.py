"""`blockrobot wallet share|shares|revoke|handle`: the owner's side of sharing."""

from __future__ import annotations

import datetime
import functools
import re
import time
from collections.abc import Sequence

import click

from clients.sdk.terminal.qr_codes import read_given
from clients.sdk.terminal.terminal import console, handle_errors, json_option, print_answer, status_line
from clients.wallet.cli.prompts import ask_or_say
from clients.wallet.cli.wallet_context import read_only_wallet, run_with_wallet
from clients.wallet.consent.rights_requests import choose
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.present.sharing_answers import (
    GranteeLook,
    HandleAnswer,
    MadeShare,
    OwnShare,
    RevokeAnswer,
    ShareAnswer,
    SharesAnswer,
)
from clients.wallet.present.translations import DEFAULT_LANGUAGE, WrongUsage, code_text, language_in_use, text
from clients.wallet.sharing.chain_grants import find_by_prefix
from clients.wallet.sharing.outgoing_shares import (
    STEP_KEYS,
    STEP_PARTS,
    STEP_SIGNING,
    Grantee,
    Share,
    Shared,
    Sharing,
    Tell,
    place_end,
    require_purpose_to_share,
    select_shareable,
)
from consensus.errors import BlockRobotError
from consensus.members.handles import encode_short
from consensus.members.vouchers import ROLES
from consensus.records.sharing import GRANT_RECORDS_MAX_COUNT, GRANTEE_ROLES
from consensus.rights.purposes import require_purpose
from pages.moments import show_moment

_SPANS_MS = {"m": 60_000, "h": 3_600_000, "d": 86_400_000, "w": 7 * 86_400_000}
_SPAN = re.compile(r"([0-9]{1,6})\s*([mhdw])")
_MOMENTS = ["%Y-%m-%d", "%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M"]
_STEPS = {STEP_KEYS: "share.keys", STEP_SIGNING: "share.signing"}


def read_end(span: str | None, until: datetime.datetime | None, now_ms: int) -> int:
    """Return the end in ms: after a span (7d, 12h), or at a local time."""
    if span is not None and until is not None:
        raise WrongUsage("end_twice")
    if span is None and until is None:
        raise WrongUsage("how_long")
    if until is not None:
        return place_end(int(until.astimezone().timestamp() * 1000), now_ms)
    found = _SPAN.fullmatch((span or "").strip())
    if found is None:
        raise WrongUsage("span")
    return place_end(now_ms + int(found[1]) * _SPANS_MS[found[2]], now_ms)


def say_role(role: str) -> str:
    return text(f"role.{role}") if role in ROLES else role


def name_grantee(grantee: Grantee) -> str:
    return text(
        "share.grantee",
        name=grantee.label or text("share.nobody"),
        role=say_role(grantee.member.role),
        organisation=grantee.member.org,
        handle=encode_short(grantee.member.handle),
    )


def explain(entries: Sequence[RecordEntry], grantee: Grantee, purpose: str, until_ms: int) -> str:
    """Describe what is shared, how long, and what is irreversible. Raises PURPOSE_UNKNOWN."""
    require_purpose(purpose)
    pictures = sum(entry.pictures_left_count for entry in entries)
    gone = sum(entry.state.expires_at_ms < until_ms for entry in entries)
    return text(
        "share.plan",
        records=text("count.records", count=len(entries)),
        things=text("count.pictures_and_sounds", count=pictures),
        sensors=", ".join(code_text("sensor", code) for code in sorted({each.metadata.sensor for each in entries})),
        first=show_moment(min(entry.metadata.started_at_ms for entry in entries)),
        last=show_moment(max(entry.metadata.ended_at_ms for entry in entries)),
        grantee=name_grantee(grantee),
        purpose=purpose,
        meaning=text(f"purpose.{purpose}"),
        until=show_moment(until_ms),
        early=text("share.early", count=gone) if gone else "",
    )


def made_share(shared: Shared) -> MadeShare:
    return MadeShare(
        grant_id=shared.grant_id.hex(),
        visit=shared.visit.owner.hex(),
        records=[record_id.hex() for record_id in shared.records],
        left_out=[record_id.hex() for record_id in shared.left_out],
        until_ms=shared.until_ms,
        pictures=shared.pictures_count,
        custodians=list(shared.custodians),
        custodians_away=list(shared.absent),
    )


def tell_of_first(error: BlockRobotError, done: Sequence[Shared], language: str = DEFAULT_LANGUAGE) -> BlockRobotError:
    """Extend a failure with completed grants; each holds up to 64 records."""
    if not done:
        return error
    names = ", ".join(shared.grant_id.hex()[:12] for shared in done)
    count = sum(len(shared.records) for shared in done)
    detail = text("share.partly", language=language, count=count, names=names, why=error.detail)
    return BlockRobotError(error.code, detail)


async def share_each(
    sharing: Sharing,
    entries: Sequence[RecordEntry],
    grantee: Grantee,
    purpose: str,
    until_ms: int,
    tell: Tell,
    *,
    language: str = DEFAULT_LANGUAGE,
) -> list[Shared]:
    """Share records of one visit in as many grants as needed; failures name completed ones."""
    done: list[Shared] = []
    for start in range(0, len(entries), GRANT_RECORDS_MAX_COUNT):
        part = entries[start : start + GRANT_RECORDS_MAX_COUNT]
        try:
            done.append(await sharing.share(part, grantee, purpose, until_ms, tell))
        except BlockRobotError as error:
            raise tell_of_first(error, done, language) from None
    return done


def say_step(step: str) -> str:
    if step.startswith(STEP_PARTS):
        return text("share.parts", name=step.removeprefix(STEP_PARTS))
    return text(_STEPS[step])


def _show_step(show: Tell, step: str) -> None:
    show(say_step(step))


def _print_shared(shared: Shared, grantee: Grantee) -> None:
    console.print(
        text(
            "share.done",
            grantee=name_grantee(grantee),
            records=text("count.records", count=len(shared.records)),
            until=show_moment(shared.until_ms),
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
@click.option("--visit", "visits", multiple=True, help="A whole visit, by the beginning of its name.")
@click.option(
    "--with", "wanted", required=True, help="The other's handle (or @FILE), or a name under which you shared before."
)
@click.option("--as", "label", default="", help="What you call the other; it stays in your wallet.")
@click.option("--purpose", required=True, help="What for: a purpose's code.")
@click.option("--for", "span", help="For how long: 90m, 12h, 7d, 2w.")
@click.option("--until", type=click.DateTime(_MOMENTS), help="Until when, by your clock.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@json_option
@click.pass_context
@handle_errors
def share(
    ctx: click.Context,
    record_ids: tuple[str, ...],
    visits: tuple[str, ...],
    wanted: str,
    label: str,
    purpose: str,
    span: str | None,
    until: datetime.datetime | None,
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

    async def action(opened: Wallet) -> tuple[Grantee, list[Shared]]:
        require_purpose_to_share(purpose, opened.genesis.purposes)
        sharing = Sharing(opened)
        grantee = await sharing.find_grantee(read_given(wanted), label)
        reports = await opened.records()
        entries = select_shareable(reports, choose(reports, record_ids, visits), purpose)
        told = explain(entries, grantee, purpose, until_ms)
        ask_or_say(text("share.ask"), yes=yes, told=told)
        with status_line(text("share.doing"), as_json=as_json) as show:
            told = DEFAULT_LANGUAGE if as_json else language_in_use()
            tell = functools.partial(_show_step, show)
            return grantee, await share_each(sharing, entries, grantee, purpose, until_ms, tell, language=told)

    grantee, done = run_with_wallet(ctx, action)
    if as_json:
        rows, who = [made_share(shared) for shared in done], grantee.member
        print_answer(ShareAnswer(handle=who.handle.hex(), role=who.role, purpose=purpose, shared=rows))
        return
    for shared in done:
        _print_shared(shared, grantee)


def own_share(share_: Share, now_ms: int) -> OwnShare:
    grant, given = share_.grant, share_.given
    return OwnShare(
        grant_id=grant.grant_id.hex(),
        visit=share_.visit.owner.hex(),
        records=[record_id.hex() for record_id in grant.row.records],
        handle=None if given is None else given.handle.hex(),
        name=None if given is None else given.label or None,
        purpose=grant.row.purpose,
        shared_at_ms=grant.row.time,
        until_ms=grant.row.until_ms,
        status=_status(share_, now_ms),
        looks=[
            GranteeLook(time_ms=look.time_ms, records=look.records_count, custodians_released=look.released_count)
            for look in share_.looks
        ],
        confirmed_deleted=[record_id.hex() for record_id in grant.row.records if record_id in share_.confirmed],
        cut=[record_id.hex() for record_id in grant.row.records if record_id in share_.cut],
        erased=[record_id.hex() for record_id in grant.row.records if record_id in share_.erased],
    )


def _status(share_: Share, now_ms: int) -> str:
    if share_.grant.row.is_open(now_ms):
        return "open"
    return "revoked" if share_.grant.row.status == "revoked" else "over"


def share_lines(share_: Share, now_ms: int) -> list[str]:
    grant, until, status = share_.grant, show_moment(share_.grant.row.until_ms), _status(share_, now_ms)
    ends = {
        "open": text("shares.open", until=until),
        "over": text("shares.over", until=until),
        "revoked": text("shares.revoked"),
    }
    lines = [
        text(
            "shares.line",
            grant=grant.grant_id.hex()[:12],
            records=text("count.records", count=len(grant.row.records)),
            visit=share_.visit.owner.hex()[:12],
            name=share_.name,
            purpose=code_text("purpose", grant.row.purpose),
            end=text("shares.nothing_left") if status == "open" and not share_.left else ends[status],
        )
    ]
    if share_.erased:
        lines.append("  " + text("shares.erased", count=len(share_.erased)))
    if share_.cut:
        lines.append("  " + text("shares.cut", count=len(share_.cut)))
    for look in share_.looks:
        key = "shares.ready" if look.released_count else "shares.asked"
        lines.append("  " + text(key, moment=show_moment(look.time_ms), count=look.records_count))
    if not share_.looks:
        lines.append("  " + text("shares.no_looks"))
    if share_.confirmed:
        lines.append("  " + text("shares.deleted", count=len(share_.confirmed)))
    return lines


@click.command()
@json_option
@click.pass_context
@handle_errors
@read_only_wallet
def shares(ctx: click.Context, as_json: bool) -> None:
    """Show what you share, with whom, until when, who looked and when, and who says that copies are deleted.

    Example: blockrobot wallet shares
    """

    async def action(opened: Wallet) -> list[Share]:
        return await Sharing(opened).shares()

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


def tell_recipients(found: Sequence[Share]) -> None:
    """Print recipients of records to be erased (Art. 19)."""
    for each in found:
        moments = ", ".join(show_moment(each_look.time_ms) for each_look in each.looks)
        if moments:
            console.print(text("shares.told_who_looked", name=each.name, moments=moments))
        else:
            console.print(text("shares.told_who_did_not", name=each.name))


def tell_copies(found: Sequence[Share]) -> None:
    if found:
        console.print("  " + text("shares.copies"))


@click.command()
@click.argument("grant")
@json_option
@click.pass_context
@handle_errors
def revoke(ctx: click.Context, grant: str, as_json: bool) -> None:
    """End what you shared (GRANT: the beginning of its name, by `blockrobot wallet shares`). At once, and for good.

    Example: blockrobot wallet revoke 3fa2c19b07de
    """

    async def action(opened: Wallet) -> tuple[Share, bytes | None]:
        sharing = Sharing(opened)
        found = await sharing.shares()
        chosen = find_by_prefix([each.grant.grant_id for each in found], grant)
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
        console.print(text("revoke.done", count=len(ended.grant.row.records), name=ended.name))
    if ended.looks:
        console.print("  " + text("revoke.looked"))


@click.command()
@json_option
@click.pass_context
@handle_errors
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
        console.print("  " + text("handle.not_for", role=say_role(role)))
    else:
        console.print("  " + text("handle.tell"))


COMMANDS = (share, shares, revoke, handle)
