"""`blockrobot producer`: producers, candidates and equivocation."""

from __future__ import annotations

from collections.abc import Callable

import click
import msgspec

from clients.sdk.chain.governance import (
    Decision,
    Governor,
    MembershipView,
    ProducersView,
    ProvedCandidate,
    read_membership,
    read_producers,
)
from clients.sdk.network_client import NetworkClient
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, console, print_answer
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES, PrivateKey
from network.cli.governance.governance_answers import (
    Equivocation,
    ProducerCandidate,
    ProducerListAnswer,
    ProducerVoteAnswer,
)
from network.cli.governance.governance_signer import (
    AdminOptions,
    Signer,
    governing_options,
    plain_table,
    shown_id,
    to_json,
    with_client,
)
from network.cli.governance.quorum_check import TOLERANT_MIN_COUNT, anyway_option, require_live_quorum, seats_after


@click.group()
def producer() -> None:
    """The producers of blocks: seats, votes, readiness, suspensions with their evidence.

    Example: blockrobot producer approve node-5 --as university
    """


async def _read(client: NetworkClient, key: PrivateKey) -> tuple[ProducersView, MembershipView]:
    return await read_producers(client, key), await read_membership(client, key)


def _candidate_answer(row: ProvedCandidate) -> ProducerCandidate:
    return ProducerCandidate(
        key=row.key.hex(),
        node=row.name,
        organisation=row.organisation,
        status=row.status,
        turn=row.turn,
        leads=row.leads,
        votes=list(row.votes),
        removals=list(row.removals),
        ready_height=row.ready_height,
        ready_ms=row.ready_ms,
        suspended_height=row.suspended_height,
        evidence=msgspec.convert(to_json(dict(row.evidence)), Equivocation) if row.evidence else None,
    )


def _ready(row: ProvedCandidate, view: ProducersView) -> str:
    if row.status == "producing":
        return "seated"
    if row.ready_ms == 0:
        return "not yet"
    return f"at height {row.ready_height}, {max(0, view.timestamp_ms - row.ready_ms) // 1000} s ago"


def _seat_of(row: ProvedCandidate) -> str:
    if row.turn is None:
        return "-"
    return str(row.turn + 1) if row.leads else f"{row.turn + 1}*"


def _print_evidence(row: ProvedCandidate) -> None:
    """Two signatures over two ids in one round prove it to outsiders."""
    evidence = row.evidence
    console.print(
        f"\n{escape(row.name)} signed two {evidence['kind']}s in epoch {evidence['epoch']}, round {evidence['round']}; "
        f"entered on chain at height {evidence['height']} by key {shown_id(evidence['accuser'])}."
    )
    for which in ("first", "second"):
        console.print(
            f"  {which}: block {evidence[which + '_id'].hex()}\n  signature {evidence[which + '_signature'].hex()}"
        )


@producer.command("list")
@governing_options
@command_output
def list_producers(admin: AdminOptions, as_json: bool) -> None:
    """Show seats, votes, who is ready and who is suspended with the evidence, checked against proofs.

    Example: blockrobot producer list
    """
    view, membership = admin.read(_read)
    needed = membership.majority
    if as_json:
        answer = ProducerListAnswer(
            height=view.height,
            epoch=view.epoch.number,
            since_height=view.since_height,
            max_producers=view.max_producers,
            votes_needed=needed,
            producers=[_candidate_answer(row) for row in view.candidates],
        )
        print_answer(answer)
        return
    seats = f"{view.max_producers} seats at most, {needed} votes to enter"
    title = f"Producers of epoch {view.epoch.number}, as of height {view.height}; {seats}"
    table = plain_table(title, ["turn", "node", "of", "status", "votes", "ready", "key"])
    for row in view.candidates:
        votes = "all" if len(row.votes) == len(membership.organisations) else ", ".join(row.votes) or "none"
        if row.removals:
            votes += f"; for removal: {', '.join(row.removals)}"
        cells = [_seat_of(row), row.name, row.organisation, row.status, votes, _ready(row, view), shown_id(row.key)[:8]]
        table.add_row(*map(escape, cells))
    console.print(table)
    if view.epoch.leaderless:
        console.print("* keeps its seat and its vote, and leads nothing")
    for row in view.candidates:
        if row.evidence:
            _print_evidence(row)
    if any(row.status == "suspended" for row in view.candidates):
        console.print(
            "\nA majority of votes brings a suspended producer back: blockrobot producer approve NODE --as ORG"
        )


def _resolve_key(text: str, view: ProducersView, membership: MembershipView) -> bytes:
    """Accepts a node name, key or key prefix. Raises NOT_FOUND."""
    known = {node.producer_key: node.name for node in membership.nodes if node.producer_key}
    known.update({row.key: row.name for row in view.candidates})
    wanted = text.strip().lower()
    current = [node.producer_key for node in membership.nodes if node.name == text and node.producer_key]
    found = current or [
        key
        for key, name in known.items()
        if name == text
        or (len(wanted) >= 8 and len(wanted) <= 2 * PUBLIC_KEY_SIZE_BYTES and key.hex().startswith(wanted))
    ]
    if len(found) != 1:
        raise BlockRobotError(
            "NOT_FOUND", f"No node with a producer key is called {text!r}; see blockrobot producer list."
        )
    return found[0]


def _vote(
    node: str,
    signer: Signer,
    what: str,
    entry: str,
    *,
    as_json: bool,
    after: Callable[[ProducersView, bytes], list[ProvedCandidate]] | None = None,
) -> None:
    """Vote on a candidate and report the final standing.

    `after` computes the remaining seats to check first. Raises GOVERNANCE_QUORUM_AT_RISK.
    """

    async def run(client: NetworkClient) -> tuple[Decision, ProducersView, MembershipView, bytes]:
        view, membership = await _read(client, signer.key)
        key = _resolve_key(node, view, membership)
        if after is not None:
            await require_live_quorum(client, signer.folder, view, after(view, key))
        decision = await Governor(client, signer.key).vote(entry, key)
        now, membership = await _read(client, signer.key)
        return decision, now, membership, key

    decision, view, membership, key = with_client(signer, run)
    row = next((row for row in view.candidates if row.key == key), None)
    if as_json:
        answer = ProducerVoteAnswer(
            height=decision.height,
            txid=decision.txid.hex(),
            epoch=decision.epoch,
            producer=None if row is None else _candidate_answer(row),
            votes_needed=membership.majority,
        )
        print_answer(answer)
        return
    console.print(f"{what} {escape(node)}: final at height {decision.height}.")
    if decision.epoch is not None:
        console.print(f"Epoch {decision.epoch} begins with the block after that height: {_standing(row, view)}.")
        if len(view.epoch.producers) < TOLERANT_MIN_COUNT:
            count = len(view.epoch.producers)
            console.print(f"With {count} producers, none of them may fail: the chain goes on only while all work.")
    else:
        console.print(f"Now: {_standing(row, view)}. {_next_step(node, row, membership)}")


def _standing(row: ProvedCandidate | None, view: ProducersView) -> str:
    seats = f"{len(view.epoch.producers)} producers"
    if row is None:
        return f"it is no candidate any more; {seats}"
    ready = "" if row.status == "producing" else f", ready: {_ready(row, view)}"
    return f"{row.status}, votes: {', '.join(row.votes) or 'none'}{ready}; {seats}"


def _next_step(node: str, row: ProvedCandidate | None, membership: MembershipView) -> str:
    if row is not None and row.removals:
        return f"Next step for a removal: another organisation says blockrobot producer remove {node} --as ORG."
    if row is None or row.status in {"producing", "removed"}:
        return "Next step: see all with blockrobot producer list."
    if len(row.votes) < membership.majority:
        return f"Next step: another organisation says blockrobot producer approve {node} --as ORG."
    return "Next step: its node says by itself that it is ready, once it runs and has caught up."


@producer.command()
@click.argument("node")
@governing_options
@command_output
def propose(node: str, admin: AdminOptions, as_json: bool) -> None:
    """Make a node a candidate, with your organisation's vote. The node must be in the network (org propose add-node).

    Example: blockrobot producer propose node-5 --as hospital
    """
    _vote(node, admin.signer(), "Proposed", "propose", as_json=as_json)


@producer.command()
@click.argument("node")
@governing_options
@command_output
def approve(node: str, admin: AdminOptions, as_json: bool) -> None:
    """Vote for a candidate, or for a suspended producer's return.

    Example: blockrobot producer approve node-5 --as university
    """
    _vote(node, admin.signer(), "Voted for", "approve", as_json=as_json)


@producer.command()
@click.argument("node")
@anyway_option
@governing_options
@command_output
def withdraw(node: str, anyway: bool, admin: AdminOptions, as_json: bool) -> None:
    """Take your organisation's vote back. A producer without any vote loses its seat.

    Example: blockrobot producer withdraw node-5 --as university
    """
    signer = admin.signer()
    after = None if anyway else lambda view, key: seats_after(view, withdrawn=(key, signer.name))
    _vote(node, signer, "Vote withdrawn from", "withdraw", as_json=as_json, after=after)


@producer.command()
@click.argument("node")
@anyway_option
@governing_options
@command_output
def remove(node: str, anyway: bool, admin: AdminOptions, as_json: bool) -> None:
    """Stand for a producer's removal: one of your own goes at once, another's when a majority says so.

    It is refused while too few of those who would be left are well, unless you say --anyway.

    Example: blockrobot producer remove node-5 --as hospital
    """
    after = None if anyway else lambda view, key: seats_after(view, leaving={key})
    _vote(node, admin.signer(), "Removal of", "remove", as_json=as_json, after=after)
