"""`blockrobot officer lost-keys`: two officers erase by robot and span."""

from __future__ import annotations

from typing import Any

import click

from clients.officer.lost_keys import LostKeys, OrderedErasures, Preview, Proposal
from clients.officer.officer_answers import (
    LostKeysDecisionAnswer,
    LostKeysEraseAnswer,
    LostKeysListAnswer,
    LostKeysPreviewAnswer,
    LostKeysProposalAnswer,
    VisitInSpan,
)
from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.terminal import command_output, console, pluralize, print_answer
from clients.wallet.cli.times import MOMENT
from clients.wallet.cli.wallet_context import confirm_or_print, read_only_wallet, run_with_wallet
from clients.wallet.presentation.invocation import OFFICER_COMMAND, called
from consensus.errors import BlockRobotError
from consensus.rights.right_codes import (
    LOST_KEY_APPROVE_MS,
    LOST_KEY_CARRY_OUT_MS,
    LOST_KEY_REASONS,
    LOST_KEY_VISITS_MAX_COUNT,
)
from pages.time_format import format_time

_DAY_MS = 24 * 3600 * 1000


@click.group("lost-keys")
def lost_keys() -> None:
    """Erase for somebody whose key is lost for good: by robot and minutes, two officers together.

    One officer proposes, a second one approves within three days, and either has it carried out within seven. The chain
    cannot say whose visits they are: others whom that robot met in those minutes lose theirs too. So name the minutes as
    exactly as you can. Whoever lost nothing erases by their own wallet: blockrobot wallet erase.

    Example: blockrobot officer lost-keys preview --robot 02ab34cd5e --from "2026-03-01 09:30" --until "2026-03-01 09:40"
    """


def _span_options(command: Any) -> Any:
    for option in (
        click.option("--until", "until_ms", type=MOMENT, required=True, help="When it ends, at most an hour later."),
        click.option("--from", "from_ms", type=MOMENT, required=True, help='When it begins, as "2026-03-01 09:30".'),
        click.option(
            "--robot", default="", help="The robot, by the beginning of its key. [default: the one that was there]"
        ),
    ):
        command = option(command)
    return command


def _called() -> str:
    return f"{called(OFFICER_COMMAND)} lost-keys"


def _second(proposal: Proposal) -> str:
    name = proposal.proposal_id.hex()[:12]
    if proposal.is_own:
        return (
            f"another officer, with a wallet of their own: blockrobot officer --profile THEIRS lost-keys approve {name}"
        )
    return f"you may agree: {_called()} approve {name}"


def _preview_answer(preview: Preview) -> LostKeysPreviewAnswer:
    return LostKeysPreviewAnswer(
        robot=preview.span.robot.hex(),
        from_ms=preview.span.from_ms,
        until_ms=preview.span.until_ms,
        visits=len(preview.touched),
        records=preview.records_count,
        restricted_visits=sum(visit.restricted_count > 0 for visit in preview.visits),
        denied_visits=sum(visit.denied for visit in preview.visits),
        visits_in_span=[
            VisitInSpan(
                visit=visit.owner.hex(),
                bucket_ms=visit.bucket_ms,
                erasable_records=len(visit.erasable),
                restricted_records=visit.restricted_count,
                denied=visit.denied,
            )
            for visit in preview.visits
        ],
    )


def _print_preview(preview: Preview) -> None:
    span = preview.span
    console.print(
        f"Robot {span.robot.hex()[:10]}, visits that began from {format_time(span.from_ms)} to before "
        f"{format_time(span.until_ms)}:"
    )
    what = f"{pluralize(len(preview.touched), 'visit')} with {pluralize(preview.records_count, 'record')}"
    console.print(f"  {what} would be erased.")
    restricted = sum(visit.restricted_count > 0 for visit in preview.visits)
    denied = sum(visit.denied for visit in preview.visits)
    if restricted:
        console.print(f"  Of {pluralize(restricted, 'visit')} records are restricted by the owner: those stay.")
    if denied:
        visits = pluralize(denied, "visit was", "visits were")
        console.print(f"  {visits} denied: what is denied stays with its breach (blockrobot officer breaches).")
    if preview.touched:
        console.print(
            "  [red]The chain cannot say whose visits these are.[/red] All of them go, those of others too, "
            "for everyone and for ever.\n"
            "  If that is more than one person's, make the span shorter: they may know the minute, or who was there."
        )


def _proposal_answer(proposal: Proposal) -> LostKeysProposalAnswer:
    state = proposal.state
    return LostKeysProposalAnswer(
        proposal_id=proposal.proposal_id.hex(),
        status=proposal.status,
        organisation=state.org,
        robot=state.robot.hex(),
        from_ms=state.from_ms,
        until_ms=state.until_ms,
        reason=state.reason,
        visits_max=state.visits_max,
        visits=state.visits,
        records=state.records,
        proposer=state.proposer.hex(),
        approver=state.approver.hex() or None,
        proposed_ms=state.proposed_ms,
        approved_ms=state.approved_ms or None,
        ends_ms=state.ends_ms,
    )


def _print_proposal(proposal: Proposal) -> None:
    state, name = proposal.state, proposal.proposal_id.hex()[:12]
    console.print(
        f"{name}  {proposal.status}, {state.reason}: robot {state.robot.hex()[:10]} at {state.org}, "
        f"{format_time(state.from_ms)} to {format_time(state.until_ms)}, "
        f"at most {pluralize(state.visits_max, 'visit')}; "
        f"{pluralize(state.visits, 'visit')} and {pluralize(state.records, 'record')} ordered so far"
    )
    steps = {
        "proposed": f"{_second(proposal)}, until {format_time(state.ends_ms)}",
        "approved": f"either of the two, until {format_time(state.ends_ms)}: {_called()} erase {name}",
        "lapsed": f"its time is over; if it is still wanted: {_called()} propose ...",
    }
    if proposal.status in steps:
        console.print(f"  Next: {steps[proposal.status]}")


def _print_decided(found: Preview, proposal: Proposal, line: str, *, as_json: bool) -> None:
    if as_json:
        print_answer(extend(LostKeysDecisionAnswer, _proposal_answer(proposal), preview=_preview_answer(found)))
        return
    console.print(line)
    _print_proposal(proposal)


def _require_room(found: Preview, visits: int | None) -> int:
    """Raises SPAN_EMPTY and SPAN_TOO_FULL."""
    count = len(found.touched)
    if not count:
        raise BlockRobotError("SPAN_EMPTY", "Nothing in that span is left to erase.")
    most = min(visits or count, LOST_KEY_VISITS_MAX_COUNT)
    if count > most:
        found_visits = pluralize(count, "visit is", "visits are")
        raise BlockRobotError("SPAN_TOO_FULL", f"{found_visits} in that span, and {most} may go.")
    return visits or count


@lost_keys.command("list")
@click.option("--all", "everything", is_flag=True, help="Those that are over, too.")
@click.pass_context
@command_output
@read_only_wallet
def list_proposals(ctx: click.Context, everything: bool, as_json: bool) -> None:
    """List what was proposed, how far it is, and what comes next.

    Example: blockrobot officer lost-keys list --all
    """
    found = run_with_wallet(ctx, lambda opened: LostKeys(opened).read_all())
    shown = [proposal for proposal in found if everything or proposal.is_open]
    if as_json:
        print_answer(LostKeysListAnswer(proposals=[_proposal_answer(proposal) for proposal in shown]))
        return
    if not shown:
        console.print("There is no open proposal." + ("" if everything else " (--all: those that are over, too.)"))
    for proposal in shown:
        _print_proposal(proposal)


@lost_keys.command()
@_span_options
@click.pass_context
@command_output
@read_only_wallet
def preview(ctx: click.Context, robot: str, from_ms: int, until_ms: int, as_json: bool) -> None:
    """Show how many visits and records a span would touch. Nothing is changed, and nobody is told.

    Example: blockrobot officer lost-keys preview --robot 02ab34cd5e --from "2026-03-01 09:30" --until "2026-03-01 09:40"
    """
    found = run_with_wallet(ctx, lambda opened: LostKeys(opened).preview(robot, from_ms, until_ms))
    if as_json:
        print_answer(_preview_answer(found))
        return
    _print_preview(found)
    if found.touched:
        console.print(f"  Next: {_called()} propose, with the same options and --reason CODE")


@lost_keys.command()
@_span_options
@click.option("--reason", type=click.Choice(sorted(LOST_KEY_REASONS)), required=True, help="Why: it stands for ever.")
@click.option(
    "--visits",
    type=click.IntRange(1, LOST_KEY_VISITS_MAX_COUNT),
    help="How many visits may go at most. [default: as many as are there now]",
)
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def propose(
    ctx: click.Context,
    robot: str,
    from_ms: int,
    until_ms: int,
    reason: str,
    visits: int | None,
    yes: bool,
    as_json: bool,
) -> None:
    """Propose to erase the visits of a span, after showing what it would touch. Nothing goes until another approves.

    Be sure who asks: see them, and a paper that says who they are. What you checked belongs into your own files.

    Example: blockrobot officer lost-keys propose --robot 02ab34cd5e --from "2026-03-01 09:30" --until "2026-03-01 09:40"
    --reason key-lost
    """

    async def main(handling: LostKeys) -> tuple[Preview, Proposal]:
        found = await handling.preview(robot, from_ms, until_ms)
        if not as_json:
            _print_preview(found)
        most = _require_room(found, visits)
        question = f"Propose that {pluralize(len(found.touched), 'visit is', 'visits are')} erased, all of it?"
        confirm_or_print(question, yes=yes, as_json=as_json)
        proposal_id = await handling.propose(found.span, reason, most)
        return found, await handling.find(proposal_id.hex())

    found, proposal = run_with_wallet(ctx, lambda opened: main(LostKeys(opened)))
    line = f"Proposed. Nothing is erased yet: a second officer has {LOST_KEY_APPROVE_MS // _DAY_MS} days to agree."
    _print_decided(found, proposal, line, as_json=as_json)


@lost_keys.command()
@click.argument("proposal")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def approve(ctx: click.Context, proposal: str, yes: bool, as_json: bool) -> None:
    """Agree to a colleague's proposal, after seeing what it would touch. You have checked it yourself.

    Example: blockrobot officer lost-keys approve 3fa2c19b07de
    """

    async def main(handling: LostKeys) -> tuple[Preview, Proposal]:
        before = await handling.find(proposal)
        found = await handling.preview_span(before.span)
        if not as_json:
            _print_preview(found)
            console.print(f"  Reason: {LOST_KEY_REASONS.get(before.state.reason, before.state.reason)}")
        confirm_or_print("Do you agree, having checked it yourself?", yes=yes, as_json=as_json)
        await handling.approve(before)
        return found, await handling.find(before.proposal_id.hex())

    found, after = run_with_wallet(ctx, lambda opened: main(LostKeys(opened)))
    line = f"Approved. Either of you has {LOST_KEY_CARRY_OUT_MS // _DAY_MS} days to have it carried out."
    _print_decided(found, after, line, as_json=as_json)


@lost_keys.command()
@click.argument("proposal")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def erase(ctx: click.Context, proposal: str, yes: bool, as_json: bool) -> None:
    """Have an approved proposal carried out. Say it again for what comes later: robots may deliver a day late.

    Example: blockrobot officer lost-keys erase 3fa2c19b07de
    """

    def on_progress(number: int, count: int) -> None:
        click.echo(f"visit {number + 1} of {count}: erasure is being ordered", err=True)

    async def main(handling: LostKeys) -> tuple[OrderedErasures, Proposal]:
        before = await handling.find(proposal)
        found = await handling.preview_span(before.span)
        if not as_json:
            _print_preview(found)
        if found.touched:
            question = f"Erase the records of {pluralize(len(found.touched), 'visit')} for everyone, for ever?"
            confirm_or_print(question, yes=yes, as_json=as_json)
        ordered = await handling.erase(before, on_progress)
        return ordered, await handling.find(before.proposal_id.hex())

    ordered, after = run_with_wallet(ctx, lambda opened: main(LostKeys(opened)))
    if as_json:
        answer = extend(
            LostKeysEraseAnswer,
            _proposal_answer(after),
            erasure_ids=[erasure_id.hex() for erasure_id in ordered.erasure_ids],
            ordered_visits=ordered.visits,
            ordered_records=ordered.records,
            kept_visits=ordered.kept_visits,
            left_visits=ordered.left_visits,
        )
        print_answer(answer)
        return
    if not ordered.records:
        console.print("There is nothing left to erase.")
    else:
        console.print(
            f"Ordered: {pluralize(ordered.records, 'record')} of {pluralize(ordered.visits, 'visit')}. "
            "Custodians destroy them and sign for it; each visit's audit says that two officers did this, and why."
        )
    if ordered.kept_visits:
        visits = pluralize(ordered.kept_visits, "visit stays", "visits stay")
        console.print(f"  {visits} in whole or in part: restricted, or denied.")
    if ordered.left_visits:
        visits = pluralize(ordered.left_visits, "visit is", "visits are")
        console.print(f"  {visits} more than was approved, and left. Propose the rest anew.")
    _print_proposal(after)


@lost_keys.command()
@click.argument("proposal")
@click.pass_context
@command_output
def stop(ctx: click.Context, proposal: str, as_json: bool) -> None:
    """End a proposal, approved or not. What was ordered already stays ordered.

    Example: blockrobot officer lost-keys stop 3fa2c19b07de
    """

    async def main(handling: LostKeys) -> Proposal:
        found = await handling.find(proposal)
        await handling.stop(found)
        return await handling.find(found.proposal_id.hex())

    after = run_with_wallet(ctx, lambda opened: main(LostKeys(opened)))
    if as_json:
        print_answer(_proposal_answer(after))
        return
    console.print("Stopped: nothing more is erased under it.")
    _print_proposal(after)
