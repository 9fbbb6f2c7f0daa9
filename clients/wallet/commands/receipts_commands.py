"""`blockrobot wallet receipts`: self-held proofs of requests and statements."""

from __future__ import annotations

import click

from clients.bundle.checks.chain_proofs import ProvedChain
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, console, print_answer
from clients.wallet.answers.record_answers import KeptConfirmation, KeptProblem, KeptReceipt, ReceiptsAnswer
from clients.wallet.cli.wallet_context import read_only_wallet, run_with_wallet
from clients.wallet.consent.receipt_fetching import ConsentReceipts
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.erasure_text import custodian_names
from clients.wallet.presentation.translations import describe_error, language_in_use, text
from clients.wallet.store.kept_proofs import CheckedProof, check_all
from consensus.errors import BlockRobotError
from pages.time_format import format_time

_KINDS = {
    ("erasure", "request"): "erasure",
    ("identity", "register"): "registration",
    ("identity", "rotate"): "rotation",
    ("consent", "give"): "given",
    ("consent", "refuse"): "refused",
    ("consent", "withdraw"): "withdrawn",
}


def _kind(proof: CheckedProof) -> str:
    body = proof.transaction.body
    return _KINDS.get((body.contract, body.entry), "other")


def _line(proof: CheckedProof, names: dict[bytes, str]) -> str:
    line = text(
        "kept.line",
        moment=format_time(proof.time_ms),
        what=text(f"kept.{_kind(proof)}"),
        name=proof.receipt.txid.hex()[:12],
        height=proof.height,
    )
    if proof.erasure is None:
        return line
    listed = ", ".join(names.get(key, key.hex()[:12]) for key in proof.erasure.receipts)
    return f"{line} {text('kept.confirmed', names=listed, height=proof.proved_height)}"


def _kept_receipt(proof: CheckedProof) -> KeptReceipt:
    receipts = {} if proof.erasure is None else proof.erasure.receipts
    return KeptReceipt(
        txid=proof.receipt.txid.hex(),
        kind=_kind(proof),
        height=proof.height,
        time_ms=proof.time_ms,
        proved_height=proof.proved_height,
        confirmed=[
            KeptConfirmation(custodian=key.hex(), destroyed_frames=each.destroyed_frames, time_ms=each.time)
            for key, each in receipts.items()
        ],
    )


@click.command("receipts")
@click.pass_context
@command_output
@read_only_wallet
def receipts(ctx: click.Context, as_json: bool) -> None:
    """Show the receipts whose proofs this wallet keeps, each checked here. No node is asked: it works without a network.

    They hold when every node has dropped the old blocks. Consent receipts, signed by both sides: wallet consent receipts.

    Example: blockrobot wallet receipts
    """

    async def action(opened: Wallet) -> tuple[list[CheckedProof | BlockRobotError], dict[bytes, str], int]:
        content = opened.store.content
        chain = ProvedChain(opened.genesis, ConsentReceipts(opened).epochs())
        found = list(check_all(content, chain, opened.genesis.chain_id))
        return found, custodian_names(opened, language_in_use()), content.proofs_dropped_count

    found, names, dropped_count = run_with_wallet(ctx, action)
    proofs = [each for each in found if isinstance(each, CheckedProof)]
    problems = [each for each in found if isinstance(each, BlockRobotError)]
    proofs.sort(key=lambda each: (each.height, each.index))
    if as_json:
        listed = [KeptProblem(code=error.code, detail=error.detail) for error in problems]
        kept = [_kept_receipt(each) for each in proofs]
        print_answer(ReceiptsAnswer(receipts=kept, problems=listed, dropped=dropped_count))
        return
    for proof in proofs:
        console.print(escape(_line(proof, names)))
    for error in problems:
        console.print(escape(" ".join(describe_error(error))))
    console.print(text("kept.source" if proofs else "kept.none", count=len(proofs)))
    if dropped_count:
        console.print(text("kept.dropped", count=dropped_count))
