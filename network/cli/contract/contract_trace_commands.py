"""`blockrobot contract trace`: explains a transaction's result line by line."""

from __future__ import annotations

import click
import msgspec

from clients.sdk.network_client import NetworkClient
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, console, print_answer
from consensus.primitives.keys import PrivateKey
from network.cli.contract.contract_answers import ContractTraceAnswer
from network.cli.contract.contract_signers import FindSigners, signer_options
from network.cli.governance.governance_signer import read_with_first
from network.contracts.contract_tracing import TracedTransaction, trace_transaction

TXID_BYTES = 32


@click.command()
@click.argument("txid")
@signer_options
@command_output
def trace(txid: str, find: FindSigners, as_json: bool) -> None:
    """Execute a final transaction again and show the lines that ran, their gas, and the values after each.

    The chain is executed from genesis up to that transaction, here; what nodes have pruned cannot be traced. The trace
    of a call in a test is shown by that test when it fails.

    Example: blockrobot contract trace 3fa2c19b07de... --as hospital
    """
    try:
        wanted = bytes.fromhex(txid.removeprefix("0x"))
    except ValueError:
        wanted = b""
    if len(wanted) != TXID_BYTES:
        raise click.BadParameter("a transaction's id has 64 hexadecimal digits", param_hint="TXID")
    signers = find()

    async def read(client: NetworkClient, key: PrivateKey) -> TracedTransaction:
        with console.status("Executing the chain ...") as status:
            return await trace_transaction(
                client, key, wanted, lambda done, last: status.update(f"Executing block {done} of {last} ...")
            )

    found = read_with_first(signers, read)
    if as_json:
        document = {"txid": txid, "height": found.receipt.height, **found.trace.document()}
        print_answer(msgspec.convert(document, ContractTraceAnswer))
        return
    console.print(escape(found.trace.text()))
