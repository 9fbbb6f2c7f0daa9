"""`blockrobot contract call | query`: use a contract on a running network. Must never sign what the ABI does not take."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from rich.markup import escape

from clients.sdk.http import NetworkClient
from clients.sdk.receipts import FinalReceipt
from clients.sdk.terminal import console, json_option, plain_errors, print_json
from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import PrivateKey
from contracts.kit.arguments import find_entry, read_arguments, signature_of
from contracts.kit.sources import read_source
from contracts.kit.telling import told
from contracts.vm.abi import Entry
from network.cli.contract_forms import ContractForm, find_form
from network.cli.contract_signers import find_signers, read_with_first, signer_options, take_signer, with_network
from network.cli.governing import to_json

source_option = click.option(
    "--source",
    "source_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Read the arguments by this source, not by the version that the chain has.",
)


@click.command()
@click.argument("contract")
@click.argument("view")
@click.argument("arguments", nargs=-1)
@source_option
@signer_options
@json_option
@plain_errors
def query(
    contract: str,
    view: str,
    arguments: Sequence[str],
    source_file: Path | None,
    folder: Path | None,
    officer: str | None,
    key_file: Path | None,
    wallet_profile: str | None,
    as_json: bool,
) -> None:
    """Ask a view of a contract. One node answers; its answer is not proved.

    Arguments are read by the view's types: numbers, text, bytes as 0x... or text:..., lists and objects as JSON.

    Example: blockrobot contract query settings in_force --json
    """
    signers = find_signers(folder, officer, key_file, wallet_profile)
    source = _read_source(source_file)

    async def read(client: NetworkClient, key: PrivateKey) -> Any:
        form = await find_form(client, key, contract, source)
        values = read_arguments(find_entry(form.abi, view, "view"), arguments)
        return await client.query(contract, view, values, key)

    result = read_with_first(signers, read)
    if as_json:
        print_json({"ok": True, "contract": contract, "view": view, "result": to_json(result)})
        return
    console.print(escape(told(result)))


@click.command()
@click.argument("contract")
@click.argument("entry")
@click.argument("arguments", nargs=-1)
@source_option
@signer_options
@json_option
@plain_errors
def call(
    contract: str,
    entry: str,
    arguments: Sequence[str],
    source_file: Path | None,
    folder: Path | None,
    officer: str | None,
    key_file: Path | None,
    wallet_profile: str | None,
    as_json: bool,
) -> None:
    """Sign a call of a contract's entry, wait until it is final, and show the proved receipt.

    Arguments are read by the entry's types: numbers, text, bytes as 0x... or text:..., lists and objects as JSON.

    Example: blockrobot contract call settings propose heartbeat_ms 9000 --as hospital
    """
    signer = take_signer(find_signers(folder, officer, key_file, wallet_profile))
    source = _read_source(source_file)

    async def send(client: NetworkClient) -> tuple[FinalReceipt, ContractForm, Entry]:
        form = await find_form(client, signer.key, contract, source)
        found = find_entry(form.abi, entry, "export")
        values = read_arguments(found, arguments)
        transaction = client.transactions.build(signer.key, contract, entry, values)
        try:
            return await client.submit_and_wait(transaction), form, found
        except asyncio.CancelledError:
            click.echo(f"No longer waiting; it may still become final: txid {transaction.txid.hex()}", err=True)
            raise

    receipt, form, found = with_network(signer, send)
    if as_json:
        print_json(_receipt_json(receipt))
    else:
        _print_receipt(receipt, form, signature_of(found))
    if not receipt.ok:
        raise click.exceptions.Exit(1)


def _read_source(path: Path | None) -> str | None:
    return None if path is None else read_source(path)


def _receipt_json(receipt: FinalReceipt) -> dict[str, Any]:
    return {
        "ok": receipt.ok,
        "txid": receipt.txid.hex(),
        "height": receipt.height,
        "index": receipt.index,
        "code": receipt.code,
        "message": receipt.message,
        "line": receipt.line,
        "gas_used": receipt.gas_used,
        "events": [
            {"contract": event.contract, "name": event.name, "data": to_json(decode_value(event.data))}
            for event in receipt.events
        ],
    }


def _print_receipt(receipt: FinalReceipt, form: ContractForm, signature: str) -> None:
    place = f"final at height {receipt.height}, {receipt.gas_used} gas, txid {receipt.txid.hex()}"
    if receipt.ok:
        console.print(f"OK: {place}")
        for event in receipt.events:
            console.print(escape(f"  {event.contract}.{event.name} {told(decode_value(event.data))}"))
        return
    console.print(escape(f"Refused: {receipt.code}{': ' if receipt.message else ''}{receipt.message}"))
    if receipt.line is not None and not receipt.message.startswith("In contract "):
        console.print(escape(f"  {form.abi.contract}:{receipt.line}: {form.line(receipt.line)}"))
    console.print(f"  {place}")
    console.print(escape(f"Next step: {_next_step(receipt, signature)}"))


def _next_step(receipt: FinalReceipt, signature: str) -> str:
    match receipt.code:
        case "OUT_OF_GAS" | "MEMORY_BUDGET" | "WRITE_BUDGET" | "EVENT_BUDGET":
            return "let one call do less: give it less data, or split the entry."
        case "ARGUMENTS_INVALID" | "ENTRY_UNKNOWN" | "CONTRACT_UNKNOWN":
            return f"compare with what the chain has: {signature}."
    return f"nothing was changed; see why: blockrobot contract trace {receipt.txid.hex()}"
