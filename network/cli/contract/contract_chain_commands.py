"""`blockrobot contract call | query`: uses a contract on a running network."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from msgspec import UNSET

from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.network_client import NetworkClient
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FILE, command_output, console, print_answer
from consensus.errors import BlockRobotError
from consensus.exit_codes import EXIT_REFUSED
from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import PrivateKey
from contracts.kit.arguments import find_entry, format_value, read_arguments, signature_of
from contracts.kit.sources import read_source
from network.cli.contract.contract_answers import CallRefusal, ContractCallAnswer, ContractQueryAnswer, EmittedEvent
from network.cli.contract.contract_signers import FindSigners, signer_options, take_signer
from network.cli.governance.governance_signer import read_with_first, to_json, with_network
from network.contracts.chain_contracts import Edition, edition_of_source, read_edition


async def find_edition(client: NetworkClient, key: PrivateKey, name: str, file: Path | None) -> Edition:
    """This file, or the version in force. Raises CONTRACT_NOT_FOUND or _SOURCE_INVALID."""
    if file is not None:
        return edition_of_source(read_source(file), name, str(file))
    return await read_edition(client, key, name, 0)


MISFITS = frozenset({"ARGUMENTS_INVALID", "ENTRY_UNKNOWN", "CONTRACT_UNKNOWN"})

source_option = click.option(
    "--source",
    "source_file",
    type=FILE,
    help="Read the arguments by this source, not by the version that the chain has.",
)


class TypedCommand(click.Command):
    """A command that explains negative number arguments mistaken for options."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        written = list(args)
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if not error.option_name[1:2].isdigit():
                raise
            given = next((text for text in written if text.startswith(error.option_name)), error.option_name)
            sentence = f"{given} is taken for an option: write -- before the first argument that begins with a minus."
            raise click.UsageError(sentence, ctx) from None


@click.command(cls=TypedCommand)
@click.argument("contract")
@click.argument("view")
@click.argument("arguments", nargs=-1)
@source_option
@signer_options
@command_output
def query(
    contract: str, view: str, arguments: Sequence[str], source_file: Path | None, find: FindSigners, as_json: bool
) -> None:
    """Ask a view of a contract. One node answers; its answer is not proved.

    Arguments are read by the view's types: numbers, text, bytes as 0x... or text:..., lists and objects as JSON.

    Example: blockrobot contract query settings in_force --json
    """
    signers = find()

    async def read(client: NetworkClient, key: PrivateKey) -> Any:
        edition = await find_edition(client, key, contract, source_file)
        values = read_arguments(find_entry(contract, edition.abi, view, "view"), arguments)
        return await client.query(contract, view, values, key)

    result = read_with_first(signers, read)
    if as_json:
        print_answer(ContractQueryAnswer(contract=contract, view=view, result=to_json(result)))
        return
    console.print(escape(format_value(result)))


@click.command(cls=TypedCommand)
@click.argument("contract")
@click.argument("entry")
@click.argument("arguments", nargs=-1)
@source_option
@signer_options
@command_output
def call(
    contract: str, entry: str, arguments: Sequence[str], source_file: Path | None, find: FindSigners, as_json: bool
) -> None:
    """Sign a call of a contract's entry, wait until it is final, and show the proved receipt.

    Arguments are read by the entry's types: numbers, text, bytes as 0x... or text:..., lists and objects as JSON.

    Example: blockrobot contract call settings propose heartbeat_ms 9000 --as hospital
    """
    signer = take_signer(find())

    async def send(client: NetworkClient) -> tuple[FinalReceipt, Edition | None]:
        edition = await find_edition(client, signer.key, contract, source_file)
        values = read_arguments(find_entry(contract, edition.abi, entry, "export"), arguments)
        transaction = client.transactions.build(signer.key, contract, entry, values)
        try:
            receipt = await client.submit_and_wait(transaction)
        except asyncio.CancelledError:
            click.echo(f"No longer waiting; it may still become final: txid {transaction.txid.hex()}", err=True)
            raise
        if receipt.ok or (source_file is not None and receipt.code not in MISFITS):
            return receipt, edition
        return receipt, await _edition_now(client, signer.key, contract)

    receipt, edition = with_network(signer, send)
    next_step = "" if receipt.ok else _next_step(receipt, edition, contract, entry)
    if as_json:
        print_answer(_receipt_answer(receipt, next_step), ok=receipt.ok)
    else:
        _print_receipt(receipt, edition, contract, next_step)
    if not receipt.ok:
        raise click.exceptions.Exit(EXIT_REFUSED)


async def _edition_now(client: NetworkClient, key: PrivateKey, contract: str) -> Edition | None:
    try:
        await client.catch_up(key)
        return await find_edition(client, key, contract, None)
    except BlockRobotError:
        return None


def _receipt_answer(receipt: FinalReceipt, next_step: str) -> ContractCallAnswer:
    detail = f"{receipt.code}: {receipt.message}" if receipt.message else receipt.code
    error = CallRefusal(code="CALL_REFUSED", detail=detail, next_step=next_step)
    return ContractCallAnswer(
        txid=receipt.txid.hex(),
        height=receipt.height,
        index=receipt.index,
        code=receipt.code,
        message=receipt.message,
        line=receipt.line,
        gas_used=receipt.gas_used,
        events=[
            EmittedEvent(contract=event.contract, name=event.name, data=to_json(decode_value(event.data)))
            for event in receipt.events
        ],
        error=UNSET if receipt.ok else error,
    )


def _print_receipt(receipt: FinalReceipt, edition: Edition | None, contract: str, next_step: str) -> None:
    place = f"final at height {receipt.height}, {receipt.gas_used} gas, txid {receipt.txid.hex()}"
    if receipt.ok:
        console.print(f"OK: {place}")
        for event in receipt.events:
            console.print(escape(f"  {event.contract}.{event.name} {format_value(decode_value(event.data))}"))
        return
    console.print(escape(f"Refused: {receipt.sentence}"))
    if edition is not None and receipt.line is not None and not receipt.message.startswith("In contract "):
        console.print(escape(f"  {contract}:{receipt.line}: {edition.line(receipt.line)}"))
    console.print(f"  {place}")
    console.print(escape(f"Next step: {next_step}"))


def _next_step(receipt: FinalReceipt, edition: Edition | None, contract: str, entry: str) -> str:
    if receipt.code in {"OUT_OF_GAS", "MEMORY_BUDGET", "WRITE_BUDGET", "EVENT_BUDGET"}:
        return "let one call do less: give it less data, or split the entry."
    if receipt.code not in MISFITS:
        return f"nothing was changed; see why: blockrobot contract trace {receipt.txid.hex()}"
    shown = f"blockrobot contract show {contract} --abi"
    if edition is None:
        return f"compare with what the chain has: {shown}"
    found = next((one for one in edition.abi if (one.name, one.kind) == (entry, "export")), None)
    if found is None:
        return f"the chain's version has no entry {entry} any more; see what it has: {shown}"
    return f"compare with what the chain has: {signature_of(found)}."
