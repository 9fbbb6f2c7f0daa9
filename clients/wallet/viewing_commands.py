"""`blockrobot wallet view|verify`: records fetched, checked and opened. Must never show what is not as it was taken."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clients.sdk.terminal import console, json_option, plain_errors, print_json
from clients.wallet.choosing import choose_records, tell_visits_linked
from clients.wallet.opening import run_opened
from clients.wallet.pictures import write_pictures
from clients.wallet.viewing import RecordView, Viewing
from clients.wallet.wallet import RecordEntry, Wallet


async def _view_all(
    opened: Wallet, entries: list[RecordEntry], purpose: str, *, verdict: bool, out: Path | None
) -> list[RecordView]:
    viewing = Viewing(opened)
    views: list[RecordView] = []
    for start in range(0, len(entries), 64):
        for owner in {entry.visit.owner for entry in entries[start : start + 64]}:
            part = [entry for entry in entries[start : start + 64] if entry.visit.owner == owner]
            access_id = await viewing.request_access(part, purpose)
            for entry in part:
                view = await viewing.view(entry, access_id)
                if verdict:
                    await viewing.put_verdict(view)
                if out:
                    await write_pictures(viewing, view, out)
                views.append(view)
    return views


def _view_json(view: RecordView) -> dict[str, Any]:
    return {
        "record_id": view.entry.record_id.hex(),
        "verdict": view.verdict,
        "custodians": list(view.custodians),
        "frames": [{"index": frame.index, "status": frame.status} for frame in view.frames],
    }


def _print_views(views: list[RecordView], *, as_json: bool, out: Path | None) -> None:
    if as_json:
        print_json({"ok": True, "records": [_view_json(view) for view in views], "out": str(out) if out else None})
        return
    if not views:
        console.print("There is nothing to show.")
        return
    for view in views:
        pictures = sum(frame.status != "notice" for frame in view.frames)
        whole = sum(frame.status == "ok" for frame in view.frames)
        line = f"{view.entry.record_id.hex()}: {whole} of {pictures} pictures are as the robot took them"
        if view.corrupted:
            line += f"; [red]changed since: {', '.join(map(str, view.corrupted))}[/red]"
        console.print(line + ".")
    if out:
        console.print(f"The pictures are in {out}.")


@click.command()
@click.argument("record_ids", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("pictures"), show_default=True)
@click.option("--purpose", default="own-access", show_default=True, help="Why you look: it stands in the audit trail.")
@json_option
@click.pass_context
@plain_errors
def view(ctx: click.Context, record_ids: tuple[str, ...], out: Path, purpose: str, as_json: bool) -> None:
    """Fetch, check and decrypt records (all if none is named) and write them as pictures, labels and sounds.

    Example: blockrobot wallet view 3fa2c19b07de --out pictures
    """

    async def action(opened: Wallet) -> list[RecordView]:
        entries = tell_visits_linked(await choose_records(opened, record_ids), as_json=as_json)
        return await _view_all(opened, entries, purpose, verdict=False, out=out)

    _print_views(run_opened(ctx, action), as_json=as_json, out=out)


@click.command()
@click.argument("record_ids", nargs=-1)
@click.option("--purpose", default="own-access", show_default=True, help="Why you look: it stands in the audit trail.")
@json_option
@click.pass_context
@plain_errors
def verify(ctx: click.Context, record_ids: tuple[str, ...], purpose: str, as_json: bool) -> None:
    """Check records against the chain on this machine, trusting no node, and put the verdict on the chain.

    Example: blockrobot wallet verify
    """

    async def action(opened: Wallet) -> list[RecordView]:
        entries = tell_visits_linked(await choose_records(opened, record_ids), as_json=as_json)
        return await _view_all(opened, entries, purpose, verdict=True, out=None)

    _print_views(run_opened(ctx, action), as_json=as_json, out=None)


COMMANDS = (view, verify)
