"""`blockrobot wallet audit`: records' history, and a probe of custodians' refusals."""

from __future__ import annotations

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, console, print_answer
from clients.wallet.answers.record_answers import AuditAnswer, AuditEvent, ProbeAnswer
from clients.wallet.cli.wallet_context import read_only_wallet, run_with_wallet
from clients.wallet.ledger.visit_audit import AuditEntry, audit_all, records_of
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.audit_story import describe_event, event_sentence
from clients.wallet.presentation.erasure_text import custodian_names
from clients.wallet.presentation.translations import language_in_use, text
from clients.wallet.text_catalogue import DEFAULT_LANGUAGE
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from pages.time_format import format_time


@click.command()
@click.pass_context
@command_output
@read_only_wallet
def audit(ctx: click.Context, as_json: bool) -> None:
    """Show everything that happened to your records, in order.

    Example: blockrobot wallet audit
    """

    async def action(opened: Wallet) -> tuple[list[AuditEntry], dict[bytes, str]]:
        return await audit_all(opened), custodian_names(opened, language_in_use())

    entries, names = run_with_wallet(ctx, action)
    if as_json:
        rows = [
            AuditEvent(
                visit=entry.owner.hex(),
                index=entry.index,
                record_id=entry.record_id.hex(),
                kind=entry.kind,
                time_ms=entry.time_ms,
                height=entry.height,
                records=[record_id.hex() for record_id in records_of(entry)],
                detail=describe_event(entry.kind, entry.data, DEFAULT_LANGUAGE),
            )
            for entry in entries
        ]
        print_answer(AuditAnswer(entries=rows))
        return
    if not entries:
        console.print(text("audit.nothing"))
    for entry in entries:
        if entry.record_id:
            subject = text("audit.record", name=entry.record_id.hex())
        else:
            subject = text("audit.visit", name=entry.owner.hex()[:12])
        block = text("audit.block", height=f"{entry.height:>5}")
        detail = describe_event(entry.kind, entry.data)
        about = f"{subject}; {detail}" if detail else subject
        sentence = event_sentence(entry, names, language_in_use())
        console.print(escape(f"{format_time(entry.time_ms)}  {block}  {sentence} ({about})"))


@click.command(hidden=True)
@click.argument("record_id")
@click.pass_context
@command_output
def probe(ctx: click.Context, record_id: str, as_json: bool) -> None:
    """Ask every custodian for a record that is not this wallet's, and say how each refuses (for demonstrations).

    Example: blockrobot wallet probe 3fa2c19b07de5a41b6f0c2d4e8a19377
    """

    async def action(opened: Wallet) -> dict[str, str]:
        refusals = {}
        for custodian in opened.network.custody.custodians:
            for name, key in (("member", opened.keys.identity), *_own_owner(opened)):
                try:
                    await opened.network.custody.download_clip(custodian, bytes.fromhex(record_id), bytes(32), key)
                except BlockRobotError as error:
                    refusals[f"{custodian.name} as {name}"] = error.code
                else:
                    refusals[f"{custodian.name} as {name}"] = "RELEASED"
        return refusals

    refusals = run_with_wallet(ctx, action)
    if as_json:
        print_answer(ProbeAnswer(refusals=refusals))
    else:
        for name, code in refusals.items():
            console.print(f"{name}: {code}")


def _own_owner(opened: Wallet) -> list[tuple[str, PrivateKey]]:
    visits = opened.store.content.visits
    return [("owner of another visit", opened.owner_key(visits[0]))] if visits else []
