"""`blockrobot contract propose | approve | ...`: organisations change contracts via `lifecycle`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import click

from clients.sdk.chain.governance import Decision, Governor, MembershipView, ProvedProposal
from clients.sdk.network_client import NetworkClient
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXISTING_FILE, command_output, console, print_answer
from consensus.errors import BlockRobotError
from consensus.state.identity import ADMIN
from consensus.state.lifecycle import UPLOADS
from contracts.kit.sources import read_source
from contracts.lifecycle.registry import compute_source_hash
from contracts.vm import compile_contract
from network.cli.cluster.cluster_options import as_one
from network.cli.contract.contract_answers import ContractDecisionAnswer
from network.cli.contract.contract_waiting import ChangeOutcome, await_change, no_wait_option
from network.cli.governance.governance_signer import (
    AdminOptions,
    Signer,
    SubmittedAct,
    command_group,
    decide_on_proposal,
    governing_options,
    proposal_answer,
    propose_once,
    report_decision,
    shown_id,
    summary_of,
    with_client,
    withdraw_command,
)
from network.contracts.chain_contracts import read_contracts

OPEN_OF_ONE_MAX_COUNT = 4


UPLOADS_MAX_COUNT = 4


async def _require_room(
    signer: Signer, client: NetworkClient, membership: MembershipView, _: str, arguments: Mapping[str, Any]
) -> None:
    """Refuse uploads without room or evicting another's source. Raises GOVERNANCE_PROPOSALS_TOO_MANY."""
    admin_key = ADMIN.key(signer.key.public_key)
    organisation = (await client.state_values([admin_key], signer.key)).values[admin_key] or signer.name
    own = [row for row in membership.proposals if row.organisation == organisation]
    if len(own) >= OPEN_OF_ONE_MAX_COUNT:
        oldest = min(own, key=lambda row: row.height)
        text = f"{organisation} has {len(own)} open proposals, and more than {OPEN_OF_ONE_MAX_COUNT} it may not have."
        raise BlockRobotError("GOVERNANCE_PROPOSALS_TOO_MANY", f"{text} {_way_out(oldest, organisation)}")
    place = UPLOADS.key(organisation)
    uploads = (await client.state_values([place], signer.key)).values[place] or []
    hashes = [entry["source_hash"] for entry in uploads]
    if arguments["source_hash"] in hashes or len(hashes) < UPLOADS_MAX_COUNT:
        return
    for row in own:
        if (row.contract, row.kind) == ("lifecycle", "deploy") and row.arguments["source_hash"] == hashes[0]:
            text = f"The upload would push out the source of {organisation}'s open proposal {shown_id(row.id)}."
            raise BlockRobotError("GOVERNANCE_PROPOSALS_TOO_MANY", f"{text} {_way_out(row, organisation)}")


def _way_out(row: ProvedProposal, organisation: str) -> str:
    command = f"blockrobot {command_group(row.contract)} withdraw {shown_id(row.id)} --as {organisation}"
    return f"Take one back, such as {summary_of(row)}: {command}"


PART_BYTES = 6000

height_option = click.option(
    "--height", type=click.IntRange(min=0), default=0, help="Not before this height (it also waits for the approval)."
)
delay_option = click.option(
    "--delay", type=click.IntRange(min=0), default=0, help="So many blocks after the approval, at least one."
)
note_option = click.option("--note", default="", help="Why; kept on the chain, at most 280 characters.")


version_option = click.option(
    "--version", type=click.IntRange(min=1), help="The version that is meant, if not the one in force now."
)


def _when(height: int, delay: int, note: str) -> dict[str, Any]:
    return {"height": height, "delay": delay, "note": note}


when_options = as_one("when", _when, height_option, delay_option, note_option)


def _version_in_force(signer: Signer, name: str) -> int:
    async def read(client: NetworkClient) -> int:
        row = (await read_contracts(client, signer.key)).find(name)
        return 0 if row is None else row.version

    return with_client(signer, read)


def _report(signer: Signer, submitted: SubmittedAct, what: str, name: str, *, wait: bool, as_json: bool) -> None:
    """Raises CONTRACT_CHANGE_FAILED."""
    decision = submitted.decision
    if not as_json and (submitted.proposal is not None or decision.due_height is None):
        report_decision(submitted, what, "contract", as_json=False)
        return
    if not as_json:
        console.print(
            f"{escape(what)}: decided at height {decision.height}, takes effect with block {decision.due_height}."
        )
    arrival = _await_arrival(signer, name, decision) if wait else None
    if arrival is not None and arrival.state == "failed":
        raise BlockRobotError(
            "CONTRACT_CHANGE_FAILED",
            f"{name} version {arrival.version} failed at block {decision.due_height}: {arrival.failure}",
        )
    if as_json:
        print_answer(_decision_answer(submitted, arrival))
        return
    if arrival is not None:
        console.print(escape(_told_arrival(name, arrival)))
    console.print(f"Next step: blockrobot contract show {escape(name)}")


def _await_arrival(signer: Signer, name: str, decision: Decision) -> ChangeOutcome | None:
    def on_progress(line: str) -> None:
        click.echo(line, err=True)

    return with_client(signer, lambda client: await_change(client, signer.key, name, decision, on_progress))


def _told_arrival(name: str, arrival: ChangeOutcome) -> str:
    words = {
        "in force": f"{name} version {arrival.version} is in force.",
        "disabled": f"{name} is disabled.",
    }
    return words.get(arrival.state, f"Another change of {name} has taken its place.")


def _decision_answer(submitted: SubmittedAct, arrival: ChangeOutcome | None) -> ContractDecisionAnswer:
    decision, proposal = submitted.decision, submitted.proposal
    return ContractDecisionAnswer(
        height=decision.height,
        txid=decision.txid.hex(),
        executed=decision.executed,
        due_height=decision.due_height,
        state=None if arrival is None else arrival.state,
        version=None if arrival is None else arrival.version,
        proposal=None if proposal is None else proposal_answer(proposal, submitted.membership.majority),
    )


@click.command()
@click.argument("file", type=EXISTING_FILE)
@click.option("--name", help="The contract's name, if it is not the file's.")
@when_options
@no_wait_option
@governing_options
@command_output
def propose(
    file: Path, name: str | None, when: dict[str, Any], admin: AdminOptions, no_wait: bool, as_json: bool
) -> None:
    """Upload a source and propose it: a new contract, or a new version of one.

    The source is checked here first; every part of at most 6,000 bytes is a transaction of its own, and so is the check
    by the network. With the approval of a majority the version takes effect at the beginning of a block; if it has a
    @migrate entry, that runs then.

    \b
    Example: blockrobot contract propose visitors.py --as hospital
    Example: blockrobot contract propose visitors.py --as hospital --height 5000 --note "floors"
    """
    source, contract = read_source(file), name or file.stem
    compile_contract(source, contract)
    data, source_hash = source.encode(), compute_source_hash(source)
    parts = [data[first : first + PART_BYTES] for first in range(0, len(data), PART_BYTES)]

    arguments = {"name": contract, "source_hash": source_hash, **when}

    async def upload(governor: Governor) -> None:
        for place, part in enumerate(parts):
            await governor.upload_part(source_hash, len(parts), place, part)
        await governor.check_upload(source_hash)

    signer = admin.signer()
    submitted = propose_once(signer, "lifecycle", "deploy", arguments, partial(_require_room, signer), upload)
    _report(signer, submitted, f"deploy {contract}", contract, wait=not no_wait, as_json=as_json)
    if submitted.proposal is not None and not as_json:
        shown = submitted.proposal.id.hex()[:12]
        console.print(f"They can read it first: blockrobot contract show {contract} --proposal {shown} --source")


@click.command()
@click.argument("proposal")
@no_wait_option
@governing_options
@command_output
def approve(proposal: str, admin: AdminOptions, no_wait: bool, as_json: bool) -> None:
    """Stand behind a proposed change of a contract; with a majority it is decided.

    Example: blockrobot contract approve 3fa2c19b07de --as university
    """
    signer = admin.signer()
    submitted, row = decide_on_proposal(signer, "lifecycle", proposal, "approve")
    _report(signer, submitted, summary_of(row), row.arguments["name"], wait=not no_wait, as_json=as_json)


withdraw = withdraw_command("lifecycle", "a change of a contract")


@click.command()
@click.argument("name")
@click.argument("version", type=click.IntRange(min=1))
@when_options
@no_wait_option
@governing_options
@command_output
def activate(name: str, version: int, when: dict[str, Any], admin: AdminOptions, no_wait: bool, as_json: bool) -> None:
    """Propose to bring a version back: to roll an upgrade back, or to end a disabled contract's rest.

    If that version has a @migrate entry it runs again, on the state as it is then.

    Example: blockrobot contract activate visitors 1 --as hospital
    """
    arguments = {"name": name, "version": version, **when}
    signer = admin.signer()
    submitted = propose_once(signer, "lifecycle", "activate", arguments)
    _report(signer, submitted, f"activate {name} version {version}", name, wait=not no_wait, as_json=as_json)


@click.command()
@click.argument("name")
@version_option
@when_options
@no_wait_option
@governing_options
@command_output
def disable(
    name: str, version: int | None, when: dict[str, Any], admin: AdminOptions, no_wait: bool, as_json: bool
) -> None:
    """Propose that a contract answers nobody any more; what it keeps stays, and changes of it that wait are dropped.

    Example: blockrobot contract disable visitors --as hospital --note "wrong floors"
    """
    signer = admin.signer()
    number = version or _version_in_force(signer, name)
    arguments = {"name": name, "version": number, **when}
    submitted = propose_once(signer, "lifecycle", "disable", arguments)
    _report(signer, submitted, f"disable {name} version {number}", name, wait=not no_wait, as_json=as_json)


@click.command()
@click.argument("name")
@version_option
@governing_options
@command_output
def keep(name: str, version: int | None, admin: AdminOptions, as_json: bool) -> None:
    """Propose to keep a version that is on trial: of forms, identity, lifecycle, membership, producers or settings.

    A new version of these goes by itself after 24 hours unless a majority keeps it. The decision is about this version:
    if another takes its place before a majority approved, it counts no more.

    Example: blockrobot contract keep membership --as hospital
    """
    signer = admin.signer()
    number = version or _version_in_force(signer, name)
    submitted = propose_once(signer, "lifecycle", "keep", {"name": name, "version": number})
    _report(signer, submitted, f"keep {name} version {number}", name, wait=False, as_json=as_json)
