"""`blockrobot contract list | show | diff`: contracts, proposals, differences."""

from __future__ import annotations

import difflib
import sys
from pathlib import Path

import click
import msgspec
from rich.syntax import Syntax

from clients.sdk.chain.governance import ID_PREFIX_MIN_CHARS, ProvedProposal, resolve_proposal
from clients.sdk.network_client import NetworkClient
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXIT_FAILED, command_output, console, print_answer
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state.lifecycle import ChangeRow, ContractEntryRow
from contracts.kit.arguments import signature_of
from contracts.kit.sources import read_source
from contracts.lifecycle.describing import NamedContract, NamedVersion
from contracts.lifecycle.registry import compute_source_hash
from network.cli.contract.contract_answers import (
    ComparedProposal,
    ContractChangeDue,
    ContractDiffAnswer,
    ContractInForce,
    ContractInterfaceEntry,
    ContractListAnswer,
    ContractShowAnswer,
    EntryParameter,
    FailedVersion,
    InterfaceChange,
)
from network.cli.governance.governance_signer import (
    AdminOptions,
    governing_options,
    plain_table,
    print_proposals,
    proposal_answer,
    shown_id,
    summary_of,
    to_json,
)
from network.contracts.chain_contracts import (
    ContractsView,
    Edition,
    compare_interfaces,
    edition_of_source,
    read_contracts,
    read_edition,
    read_proposed,
)
from pages.time_format import format_time


def _due_answer(change: ChangeRow) -> ContractChangeDue:
    return msgspec.convert(change, ContractChangeDue, from_attributes=True)


def _due_text(change: ChangeRow) -> str:
    when = f"with block {change.from_height}" if change.from_height else f"at {format_time(change.from_ms)}"
    words = {
        "activate": f"version {change.version}",
        "disable": "disabled",
        "keep": f"version {change.version} kept",
        "return": f"back to {change.version}",
    }
    return f"{words[change.kind]} {when}"


def _failed_answer(row: NamedVersion) -> FailedVersion:
    return msgspec.convert(row, FailedVersion, from_attributes=True)


def _print_failed(row: NamedVersion) -> None:
    text = f"{row.name} version {row.version} failed at height {row.since_height}: {row.failure}"
    console.print(f"[bold]{escape(text)}[/bold]")


def _told_proposal(row: ProvedProposal) -> str:
    note = f": {row.arguments['note']}" if row.arguments.get("note") else ""
    return f"Proposal {shown_id(row.id)}: {summary_of(row)}, proposed by {row.organisation}{note}"


def _compared_answer(row: ProvedProposal) -> ComparedProposal:
    return ComparedProposal(
        id=row.id.hex(), kind=row.kind, organisation=row.organisation, arguments=to_json(dict(row.arguments))
    )


def _print_proposal(row: ProvedProposal, needed: int) -> None:
    arguments = row.arguments
    console.print(escape(_told_proposal(row)))
    when = [f"not before block {arguments['height']}"] if arguments.get("height") else []
    when += [f"{arguments['delay']} blocks after the decision"] if arguments.get("delay") else []
    voices = (
        f"approved by {', '.join(row.approvals) or 'nobody'}, {needed} needed, open until {format_time(row.expires_ms)}"
    )
    console.print(escape("; ".join([voices, *when])))


@click.command("list")
@governing_options
@command_output
def list_contracts(admin: AdminOptions, as_json: bool) -> None:
    """Show the chain's contracts, their versions, what is due and what is proposed, checked against proofs.

    Example: blockrobot contract list --json
    """
    view: ContractsView = admin.read(read_contracts)
    if as_json:
        answer = ContractListAnswer(
            height=view.height,
            contracts=[_contract_answer(row) for row in view.contracts],
            due=[_due_answer(change) for change in view.due],
            failed=[_failed_answer(row) for row in view.failed],
            proposals=[proposal_answer(row, view.membership.majority) for row in view.proposals],
        )
        print_answer(answer)
        return
    columns = ["contract", "version", "of", "state", "since", "source", "due"]
    table = plain_table(f"Contracts, as of height {view.height}", columns)
    known = {row.name for row in view.contracts}
    for row in view.contracts:
        due = ", ".join(_due_text(change) for change in view.due if change.name == row.name)
        state = "answers" if row.enabled else "disabled"
        cells = [row.name, str(row.version), str(row.versions), state, str(row.since_height), shown_id(row.source_hash)]
        table.add_row(*map(escape, cells), due)
    for change in view.due:
        if change.name not in known:
            table.add_row(escape(change.name), "", "", "to come", "", "", _due_text(change))
    console.print(table)
    for row_failed in view.failed:
        _print_failed(row_failed)
    for proposal in view.proposals:
        console.print(escape(_told_proposal(proposal)))
    print_proposals(view.proposals, view.membership.majority, "contract")


def _entry_answer(entry: ContractEntryRow) -> ContractInterfaceEntry:
    return ContractInterfaceEntry(
        name=entry.name,
        kind=entry.kind,
        parameters=[EntryParameter(name=name, type=kind) for name, kind in entry.params],
        required=entry.required,
        returns=entry.returns,
    )


def _contract_answer(row: NamedContract) -> ContractInForce:
    return ContractInForce(
        name=row.name,
        version=row.version,
        versions=row.versions,
        enabled=row.enabled,
        since_height=row.since_height,
        source_hash=row.source_hash.hex(),
    )


def _show_answer(name: str, edition: Edition, view: ContractsView) -> ContractShowAnswer:
    proposal, needed = edition.proposal, view.membership.majority
    answer = ContractShowAnswer(
        name=name,
        height=view.height,
        due=[_due_answer(change) for change in view.due if change.name == name],
        failed=next((_failed_answer(row) for row in view.failed if row.name == name), None),
        proposal=None if proposal is None else proposal_answer(proposal, needed),
        abi=[_entry_answer(entry) for entry in edition.abi],
        source=edition.source,
    )
    row = edition.row
    if row is None:
        return answer
    return msgspec.structs.replace(
        answer,
        version=row.version,
        status=row.status,
        since_height=row.since_height,
        failure=row.failure,
        size_bytes=row.size_bytes,
        migrates=row.migrates,
        note=row.note,
        organisation=row.organisation,
        source_hash=row.source_hash.hex(),
        proposal_id=row.proposal_id.hex(),
        approved_height=row.approved_height,
    )


@click.command()
@click.argument("name")
@click.option("--version", type=click.IntRange(min=1), help="Another version than the one in force.")
@click.option("--proposal", help="What this open proposal would deploy.")
@click.option("--source", "with_source", is_flag=True, help="Print the source and nothing else.")
@click.option("--abi", "with_abi", is_flag=True, help="Print the entries and nothing else.")
@governing_options
@command_output
def show(
    name: str,
    version: int | None,
    proposal: str | None,
    with_source: bool,
    with_abi: bool,
    admin: AdminOptions,
    as_json: bool,
) -> None:
    """Show a contract: its version, who proposed it, its entries; with --source its text. All of it is proved.

    \b
    Example: blockrobot contract show visitors
    Example: blockrobot contract show visitors --version 1 --source
    """

    async def read(client: NetworkClient, key: PrivateKey) -> tuple[Edition, ContractsView]:
        view = await read_contracts(client, key)
        if proposal is not None:
            return await read_proposed(client, key, _proposal_about(view, name, proposal)), view
        return await read_edition(client, key, name, version or 0), view

    edition, view = admin.read(read)
    due = [change for change in view.due if change.name == name]
    if as_json:
        print_answer(_show_answer(name, edition, view))
        return
    if with_source:
        click.echo(edition.source, nl=not edition.source.endswith("\n"))
        return
    if not with_abi:
        _print_facts(edition, view, due)
    for entry in edition.abi:
        console.print(escape(f"  {entry.kind:<6}  {signature_of(entry)}"), soft_wrap=True)


def _print_facts(edition: Edition, view: ContractsView, due: list[ChangeRow]) -> None:
    console.print(f"[bold]{escape(edition.title)}[/bold], as of height {view.height}")
    row = edition.row
    if edition.proposal is not None:
        _print_proposal(edition.proposal, view.membership.majority)
    if row is not None:
        since = f" since height {row.since_height}" if row.since_height or row.status == "active" else ""
        console.print(f"{row.status}{since}; {row.size_bytes} bytes, source {shown_id(row.source_hash)}")
        origin = "shipped with BlockRobot" if not row.organisation else f"proposed by {row.organisation}"
        note = "" if row.note in ("", "Shipped with BlockRobot.") else f": {row.note}"
        console.print(escape(f"{origin}, decided at height {row.approved_height}{note}"))
        if row.failure:
            console.print(escape(f"It did not take effect: {row.failure}"))
            console.print("Next step: mend the source and propose it anew.")
        for failed in view.failed:
            if failed.name == row.name and failed.version != row.version:
                _print_failed(failed)
                console.print("Next step: mend the source and propose it anew.")
    for change in due:
        console.print(escape(f"Due: {_due_text(change)}"))
        if change.kind == "return":
            console.print(f"Next step: blockrobot contract keep {change.name} --as ORG, if it is to stay.")


@click.command()
@click.argument("name")
@click.argument("old")
@click.argument("new", required=False)
@click.option("--exit-code", "with_exit_code", is_flag=True, help="Exit with 1 if they differ.")
@governing_options
@command_output
def diff(name: str, old: str, new: str | None, with_exit_code: bool, admin: AdminOptions, as_json: bool) -> None:
    """Compare two versions of a contract: what changes for callers, and the sources line by line.

    OLD and NEW are version numbers, files, or the ids of open proposals. With one of them only, it is compared with the
    version in force. They are equal only if their hashes are; letters beyond ASCII, which may look like others, are told
    by their numbers. Exit code 0, also if they differ; with --exit-code 1 if they do.

    \b
    Example: blockrobot contract diff visitors 1 2 --exit-code
    Example: blockrobot contract diff visitors visitors.py
    Example: blockrobot contract diff visitors 3fa2c19b07de
    """

    files = {text: _read_file(name, text) for text in (old, new or "")}

    async def find(client: NetworkClient, key: PrivateKey, text: str) -> Edition:
        return files[text] or await _get_edition(client, key, name, text)

    async def read(client: NetworkClient, key: PrivateKey) -> tuple[Edition, Edition]:
        if new is None:
            return await read_edition(client, key, name, 0), await find(client, key, old)
        return await find(client, key, old), await find(client, key, new)

    before, after = admin.read(read)
    proposals = [edition.proposal for edition in (before, after) if edition.proposal is not None]
    changes = compare_interfaces(before, after)
    lines = diff_lines(before, after)
    is_equal = compute_source_hash(before.source) == compute_source_hash(after.source)
    if as_json:
        answer = ContractDiffAnswer(
            name=name,
            old=before.title,
            new=after.title,
            old_hash=compute_source_hash(before.source).hex(),
            new_hash=compute_source_hash(after.source).hex(),
            equal=is_equal,
            abi=[InterfaceChange(change=kind, entry=text) for kind, text in changes],
            diff=lines,
            proposals=[_compared_answer(row) for row in proposals],
        )
        print_answer(answer)
    else:
        for row in proposals:
            console.print(escape(_told_proposal(row)))
        if is_equal:
            console.print(escape(f"{before.title} and {after.title} are equal."))
        else:
            _print_diff(lines, changes)
    if with_exit_code and not is_equal:
        sys.exit(EXIT_FAILED)


def diff_lines(before: Edition, after: Edition) -> list[str]:
    """Unified; empty only if equal including line ends."""
    old, new = before.source.split("\n"), after.source.split("\n")
    return list(difflib.unified_diff(old, new, before.title, after.title, lineterm=""))


def beyond_ascii(lines: list[str]) -> list[str]:
    """Per changed line: some letters look like others."""
    changed = [line for line in lines[2:] if line[:1] in ("+", "-") and not line.isascii()]
    return [f"{line[0]} {' '.join(f'U+{ord(one):04X}' for one in line if ord(one) > 127)}" for line in changed]


def _print_diff(lines: list[str], changes: list[tuple[str, str]]) -> None:
    console.print("[bold]For callers[/bold]" if changes else "Nothing changes for callers.")
    for kind, text in changes:
        console.print(escape(f"  {kind:<10}  {text}"), soft_wrap=True)
    if console.is_terminal:
        console.print(Syntax("\n".join(lines), "diff", background_color="default", word_wrap=True))
    else:
        click.echo("\n".join(lines))
    strange = beyond_ascii(lines)
    if strange:
        console.print("Letters beyond ASCII in changed lines, in their order:")
    for line in strange:
        console.print(escape(f"  {line}"), soft_wrap=True)


def _read_file(name: str, text: str) -> Edition | None:
    path = Path(text)
    return edition_of_source(read_source(path), name, text) if text and path.is_file() else None


def _proposal_about(view: ContractsView, name: str, text: str) -> ProvedProposal:
    """Raises GOVERNANCE_PROPOSAL_CLOSED."""
    found = resolve_proposal(view.proposals, text)
    if found.arguments["name"] != name:
        raise BlockRobotError(
            "GOVERNANCE_PROPOSAL_CLOSED", f"The proposal {text!r} is about {found.arguments['name']}."
        )
    return found


async def _get_edition(client: NetworkClient, key: PrivateKey, name: str, text: str) -> Edition:
    if text.isdigit() and len(text) < ID_PREFIX_MIN_CHARS:
        return await read_edition(client, key, name, int(text))
    view = await read_contracts(client, key)
    try:
        proposal = _proposal_about(view, name, text)
    except BlockRobotError as error:
        known = f"{text!r} is no version's number, no file, and no open proposal about {name}."
        raise BlockRobotError(error.code, known) from None
    return await read_proposed(client, key, proposal)
