"""`blockrobot wallet mandates`: representatives and represented persons."""

from __future__ import annotations

import click

from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.terminal import command_output, console, print_answer
from clients.wallet.answers.mandate_answers import MandateAct, OwnMandate, OwnMandatesAnswer, mandate_answer
from clients.wallet.cli.wallet_context import confirm_or_print, read_only_wallet, run_with_wallet
from clients.wallet.ledger.mandates import ACTIVE, APPROVED, OPEN, Mandate, Mandates
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.translations import code_text, purposes_text, text
from consensus.members.handles import encode_short
from consensus.state.mandates import ActRow
from pages.time_format import format_time


@click.group()
def mandates() -> None:
    """See who acts for you and what was done in your name; accept to act for somebody; end it.

    Example: blockrobot wallet mandates list
    """


def _act_answer(act: ActRow) -> MandateAct:
    return MandateAct(
        kind=act.kind,
        time_ms=act.time,
        height=act.height,
        txid=act.txid.hex(),
        purposes=act.data["purposes"],
        sensors=act.data["sensors"],
        period_until_ms=act.data["until_ms"] or None,
    )


def _own_answer(mandate: Mandate, trail: list[ActRow], own: bytes) -> OwnMandate:
    role = "representative" if mandate.state.representative == own else "represented"
    return extend(OwnMandate, mandate_answer(mandate), role=role, trail=[_act_answer(act) for act in trail])


def _print_mandate(opened: Wallet, mandate: Mandate, trail: list[ActRow]) -> None:
    state, name = mandate.state, mandate.mandate_id.hex()[:12]
    is_representative = state.representative == opened.store.content.handle
    other = encode_short(state.handle if is_representative else state.representative)
    key = "mandates.you_act" if is_representative else "mandates.acts_for_you"
    status, until = code_text("mandate", mandate.status), format_time(state.until_ms)
    console.print(text(key, name=name, status=status, other=other, until=until, organisation=state.org))
    if is_representative and mandate.status == APPROVED:
        console.print("  " + text("mandates.to_accept", name=name, until=format_time(state.ends_ms)))
    if is_representative and mandate.status == ACTIVE:
        console.print("  " + text("mandates.to_act", other=other))
    if not is_representative and mandate.status in OPEN:
        console.print("  " + text("mandates.to_end", name=name))
    for act in trail:
        status_word, purposes = code_text("said", act.kind), purposes_text(act.data["purposes"])
        sensors = ", ".join(code_text("sensor", code) for code in act.data["sensors"])
        console.print(
            "  "
            + text(
                "mandates.act",
                moment=format_time(act.time),
                status=status_word,
                purposes=purposes or text("receipts.everything"),
                sensors=sensors or text("receipts.every_sensor"),
                height=act.height,
            )
        )


@mandates.command("list")
@click.option("--all", "everything", is_flag=True, help="Those that are over, too.")
@click.pass_context
@command_output
@read_only_wallet
def list_mandates(ctx: click.Context, everything: bool, as_json: bool) -> None:
    """Show who acts for you, for whom you act, and everything that was said so, proven against the chain.

    Example: blockrobot wallet mandates list --all
    """

    async def action(opened: Wallet) -> None:
        handling = Mandates(opened)
        found = [mandate for mandate in await handling.read_own() if everything or mandate.is_open]
        trails = [await handling.trail(mandate) for mandate in found]
        if as_json:
            own = opened.store.content.handle
            rows = [_own_answer(mandate, trail, own) for mandate, trail in zip(found, trails, strict=True)]
            print_answer(OwnMandatesAnswer(mandates=rows))
            return
        if not found:
            console.print(text("mandates.none"))
        for mandate, trail in zip(found, trails, strict=True):
            _print_mandate(opened, mandate, trail)

    run_with_wallet(ctx, action)


@mandates.command()
@click.argument("mandate")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def accept(ctx: click.Context, mandate: str, yes: bool, as_json: bool) -> None:
    """Accept to act for somebody who cannot. From then on you decide what may be recorded of that person.

    Example: blockrobot wallet mandates accept 3fa2c19b07de
    """

    async def action(opened: Wallet) -> Mandate:
        handling = Mandates(opened)
        before = await handling.find(mandate, own=True)
        other, until = encode_short(before.state.handle), format_time(before.state.until_ms)
        confirm_or_print(text("mandates.ask_accept", other=other, until=until), yes=yes, as_json=as_json)
        await handling.accept(before)
        return await handling.find(before.mandate_id.hex(), own=True)

    after = run_with_wallet(ctx, action)
    if as_json:
        print_answer(mandate_answer(after))
        return
    console.print(text("mandates.accepted", until=format_time(after.state.until_ms)))
    console.print("  " + text("mandates.to_act", other=encode_short(after.state.handle)))


@mandates.command()
@click.argument("mandate")
@click.pass_context
@command_output
def end(ctx: click.Context, mandate: str, as_json: bool) -> None:
    """End a mandate, or a proposal of one. What was consented to under it is withdrawn with the same block.

    Example: blockrobot wallet mandates end 3fa2c19b07de
    """

    async def action(opened: Wallet) -> Mandate:
        handling = Mandates(opened)
        found = await handling.find(mandate, own=True)
        await handling.end(found)
        return await handling.find(found.mandate_id.hex(), own=True)

    after = run_with_wallet(ctx, action)
    if as_json:
        print_answer(mandate_answer(after))
        return
    console.print(text("mandates.ended"))
