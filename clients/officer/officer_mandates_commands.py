"""`blockrobot officer mandates`: two officers appoint a representative for a person."""

from __future__ import annotations

from pathlib import Path

import click

from clients.officer.mandate_papers import (
    PapersReceipt,
    check_papers,
    find_same,
    keep_receipt,
    make_receipt,
    read_receipt,
)
from clients.sdk.node_answers import SURE_REFUSALS
from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.terminal import FILE, command_output, console, pluralize, print_answer
from clients.wallet.answers.mandate_answers import MandateProposalAnswer, MandatesAnswer, mandate_answer
from clients.wallet.cli.times import MOMENT
from clients.wallet.cli.wallet_context import confirm_or_print, read_only_wallet, run_with_wallet
from clients.wallet.ledger.mandates import APPROVED, PROPOSED, Mandate, Mandates
from clients.wallet.presentation.invocation import OFFICER_COMMAND, called
from consensus.errors import BlockRobotError
from consensus.limits import TIME_BUCKET_MS
from consensus.members.handles import encode_short
from consensus.rights.mandates import ACCEPT_MS, ACTS, APPROVE_MS, MANDATE_REASONS, PAPERS_MAX_COUNT
from pages.time_format import format_time

_DAY_MS = 24 * 3600 * 1000


@click.group()
def mandates() -> None:
    """Let somebody act for a person who cannot: a parent for a child, a guardian, an officer.

    One officer proposes, having seen the guardian's papers, a second one who sees them too approves within three days,
    and the representative accepts within seven. From then on they give and take back consent in that person's name, by
    their own wallet. The papers go nowhere: the chain gets a salted hash of them. Either of the two, and any officer of
    the organisation, ends a mandate at any time.

    Example: blockrobot officer mandates propose --for brh1-... --to brh1-... --papers birth.pdf
    --reason minor --until 2027-01-31
    """


def _print_mandate(mandate: Mandate) -> None:
    state, name = mandate.state, mandate.mandate_id.hex()[:12]
    console.print(
        f"{name}  {mandate.status}: {encode_short(state.representative)} acts for {encode_short(state.handle)} "
        f"until {format_time(state.until_ms)}, for {', '.join(state.acts)}; {state.org}"
    )
    until = format_time(state.ends_ms)
    steps = {
        PROPOSED: f"another officer who sees the papers, until {until}: "
        f"{called(OFFICER_COMMAND)} mandates approve {name} --receipt FILE --papers FILE",
        APPROVED: f"the representative, until {until}: blockrobot wallet mandates accept {name}",
    }
    if mandate.status in steps:
        console.print(f"  Next: {steps[mandate.status]}")


def _tell(mandate: Mandate, line: str, *, as_json: bool, receipt: Path | None = None) -> None:
    if as_json:
        answer = mandate_answer(mandate)
        print_answer(answer if receipt is None else extend(MandateProposalAnswer, answer, receipt=str(receipt)))
        return
    console.print(line)
    _print_mandate(mandate)


def _require_papers(papers: tuple[Path, ...]) -> None:
    if len(papers) > PAPERS_MAX_COUNT:
        raise click.UsageError(f"Name {PAPERS_MAX_COUNT} papers at most; put several into one file.")


@mandates.command()
@click.option("--for", "whom", required=True, help="The handle of the person who cannot act, whole or in short.")
@click.option("--to", "representative", required=True, help="The handle of who is to act, whole or in short.")
@click.option("--papers", type=FILE, multiple=True, required=True, help="A paper as a file; may be repeated.")
@click.option("--reason", type=click.Choice(sorted(MANDATE_REASONS)), required=True, help="Why; not told to the chain.")
@click.option("--until", "until_ms", type=MOMENT, required=True, help="When it ends, in a year at most.")
@click.option("--receipt", type=FILE, help="Write the papers' receipt here. [default: beside the first paper]")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def propose(
    ctx: click.Context,
    whom: str,
    representative: str,
    papers: tuple[Path, ...],
    reason: str,
    until_ms: int,
    receipt: Path | None,
    yes: bool,
    as_json: bool,
) -> None:
    """Propose that somebody acts for a person who cannot, having seen the papers. Nothing holds until two others agree.

    Keep the papers and the receipt together in your own files: without the receipt nobody can show later what was seen,
    and the second officer needs both.

    Example: blockrobot officer mandates propose --for brh1-... --to brh1-... --papers birth.pdf
    --reason minor --until 2027-01-31
    """
    until_ms -= until_ms % TIME_BUCKET_MS
    _require_papers(papers)
    made = make_receipt(papers, reason)

    async def main(handling: Mandates) -> tuple[Path, Mandate]:
        handle, acting = await handling.read_handle(whom), await handling.read_handle(representative)
        place = receipt or papers[0].parent / f"mandate-{handle.hex()[:12]}.json"
        if place.exists() and find_same(place, made) is None:
            raise BlockRobotError("FILE_EXISTS", f"{place} is there already, of another reason or other papers.")
        if not as_json:
            console.print(f"{encode_short(acting)} would act for {encode_short(handle)} until {format_time(until_ms)}:")
            console.print("  give and take back consent in that person's name, so that robots may record the person.")
            console.print(f"  On {pluralize(len(papers), 'paper')}: {MANDATE_REASONS[reason]}")
        confirm_or_print("Propose it, having seen the papers and both persons?", yes=yes, as_json=as_json)
        kept, is_new = keep_receipt(place, made)
        try:
            mandate_id = await handling.propose(handle, acting, kept.commitment, ACTS, until_ms)
        except BlockRobotError as error:
            if is_new and error.code in SURE_REFUSALS:  # an older one may be of a proposal that went through
                place.unlink(missing_ok=True)
            raise
        return place, await handling.find(mandate_id.hex())

    place, proposed = run_with_wallet(ctx, lambda opened: main(Mandates(opened)))
    line = f"Proposed. A second officer has {APPROVE_MS // _DAY_MS} days to agree. The papers' receipt: {place}"
    _tell(proposed, line, as_json=as_json, receipt=place)


@mandates.command()
@click.argument("mandate")
@click.option("--receipt", type=FILE, required=True, help="The papers' receipt that your colleague has.")
@click.option("--papers", type=FILE, multiple=True, required=True, help="A paper that you saw; may be repeated.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def approve(
    ctx: click.Context, mandate: str, receipt: Path, papers: tuple[Path, ...], yes: bool, as_json: bool
) -> None:
    """Agree to a colleague's proposal, having seen the same papers: every one of the receipt, or it is refused.

    Example: blockrobot officer mandates approve 3fa2c19b07de --receipt mandate-5e884898da28.json --papers birth.pdf
    """
    _require_papers(papers)
    seen: PapersReceipt = read_receipt(receipt)

    async def main(handling: Mandates) -> Mandate:
        before = await handling.find(mandate)
        check_papers(seen, before.state.papers, papers)
        if not as_json:
            _print_mandate(before)
            console.print(f"  Reason: {MANDATE_REASONS[seen.reason]}")
        confirm_or_print("Do you agree, having seen the papers and both persons yourself?", yes=yes, as_json=as_json)
        await handling.approve(before)
        return await handling.find(before.mandate_id.hex())

    after = run_with_wallet(ctx, lambda opened: main(Mandates(opened)))
    line = f"Approved. The representative has {ACCEPT_MS // _DAY_MS} days to accept it."
    _tell(after, line, as_json=as_json)


@mandates.command("list")
@click.option("--all", "everything", is_flag=True, help="Those that are over, too.")
@click.pass_context
@command_output
@read_only_wallet
def list_mandates(ctx: click.Context, everything: bool, as_json: bool) -> None:
    """List mandates and proposals, how far each is, and what comes next.

    Example: blockrobot officer mandates list --all
    """
    found = run_with_wallet(ctx, lambda opened: Mandates(opened).read_all())
    shown = [mandate for mandate in found if everything or mandate.is_open]
    if as_json:
        print_answer(MandatesAnswer(mandates=[mandate_answer(mandate) for mandate in shown]))
        return
    if not shown:
        console.print("There is no mandate." + ("" if everything else " (--all: those that are over, too.)"))
    for mandate in shown:
        _print_mandate(mandate)


@mandates.command()
@click.argument("mandate")
@click.pass_context
@command_output
def end(ctx: click.Context, mandate: str, as_json: bool) -> None:
    """End a mandate, or a proposal of one. What was consented to under it is withdrawn with the same block.

    One of another organisation is closed, if it holds no more: its time is over, one of the two persons is no member any
    more, or that organisation was removed.

    Example: blockrobot officer mandates end 3fa2c19b07de
    """

    async def main(handling: Mandates) -> Mandate:
        found = await handling.find(mandate)
        await handling.end(found)
        return await handling.find(found.mandate_id.hex())

    after = run_with_wallet(ctx, lambda opened: main(Mandates(opened)))
    _tell(after, "Ended: nobody acts for that person by it any more.", as_json=as_json)
