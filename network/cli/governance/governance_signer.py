"""Shared by governance commands: signing key, network, reporting of decisions."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import click
from rich.table import Table

from clients.sdk.chain.governance import (
    Decision,
    Governor,
    MembershipView,
    ProvedProposal,
    find_closed,
    read_membership,
    resolve_proposal,
)
from clients.sdk.network_client import NetworkClient, open_pinned_client
from clients.sdk.new_files import SMALL_FILE_MAX_BYTES, read_given_file, require_seen
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FILE, command_output, console, load_genesis, print_answer
from clients.sdk.trust_pin import PIN_FILE
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from network.cli.cluster.cluster_options import as_one, folder_option, network_folder
from network.cli.governance.governance_answers import DecisionAnswer, OpenProposal
from network.cluster import no_network
from network.provisioning.new_organisation import ADMIN_KEY_FILE
from pages.time_format import format_date, format_time

ID_SHOWN_CHARS = 12
_GROUPS = {"membership": "org", "settings": "settings", "lifecycle": "contract"}
T = TypeVar("T")
Check = Callable[[NetworkClient, MembershipView, str, Mapping[str, Any]], Awaitable[None]]
"""Refuses a change by its kind and arguments, before anything is sent."""

as_option = click.option("--as", "organisation", metavar="ORG", help="The organisation that you speak for.")
key_option = click.option(
    "--key", "key_file", type=FILE, help="The admin's key file, if it does not lie in the network's folder."
)


@dataclass(frozen=True, slots=True)
class Signer:
    """A network's folder and genesis, a signer's name (empty for an admin's key file) and key."""

    folder: Path
    genesis: Genesis
    name: str
    key: PrivateKey


def admin_keys(folder: Path) -> dict[str, Path]:
    found = sorted((folder / "organisations").glob(f"*/{ADMIN_KEY_FILE}"))
    return {path.parent.name: path for path in found}


def read_private_key(path: Path) -> PrivateKey:
    """32 raw bytes. Raises ORGANISATION_KEY_NOT_FOUND, KEY_INVALID."""
    try:
        return PrivateKey(read_given_file(path, SMALL_FILE_MAX_BYTES))
    except FileNotFoundError:
        raise BlockRobotError("ORGANISATION_KEY_NOT_FOUND", f"There is no key file {path}.") from None


def open_network(folder: Path | None) -> tuple[Path, Genesis]:
    """Raises CLUSTER_NOT_RUNNING, GENESIS_INVALID."""
    place = network_folder(folder)
    if not (place / "genesis.json").exists():
        raise no_network(place)
    return place, load_genesis(place / "genesis.json")


def with_network(signer: Signer, work: Callable[[NetworkClient], Awaitable[T]]) -> T:
    async def run() -> T:
        async with open_pinned_client(signer.genesis, signer.folder / PIN_FILE) as client:
            return await work(client)

    return asyncio.run(run())


def read_with_first(signers: list[Signer], work: Callable[[NetworkClient, PrivateKey], Awaitable[T]]) -> T:
    """The first that nodes admit; proved results are the same."""
    for place, signer in enumerate(signers):
        try:
            return with_network(signer, lambda client, key=signer.key: work(client, key))  # type: ignore[misc]
        except BlockRobotError as error:
            if error.code != "SESSION_REFUSED" or place == len(signers) - 1:
                raise
    raise AssertionError("there is at least one signer")


@contextmanager
def _refused_as_no_admin() -> Iterator[None]:
    try:
        yield
    except BlockRobotError as error:
        if error.code == "SESSION_REFUSED":
            raise BlockRobotError("GOVERNANCE_NOT_ADMIN") from None
        raise


def with_client(signer: Signer, work: Callable[[NetworkClient], Awaitable[T]]) -> T:
    """As an admin. Raises GOVERNANCE_NOT_ADMIN."""
    with _refused_as_no_admin():
        return with_network(signer, work)


@dataclass(frozen=True, slots=True)
class AdminOptions:
    """The options that say as which organisation's admin a command acts."""

    folder: Path | None = None
    organisation: str | None = None
    key_file: Path | None = None

    def signer(self) -> Signer:
        """Ambiguous names are a usage error. Raises ORGANISATION_KEY_NOT_FOUND, CLUSTER_NOT_RUNNING, KEY_INVALID."""
        signers = self._signers()
        if len(signers) > 1:
            names = " | ".join(signer.name for signer in signers)
            raise click.UsageError(f"Say for which organisation you speak: --as {names}.")
        return signers[0]

    def read(self, work: Callable[[NetworkClient, PrivateKey], Awaitable[T]]) -> T:
        """As any local organisation. Raises GOVERNANCE_NOT_ADMIN, and as `signer`."""
        with _refused_as_no_admin():
            return read_with_first(self._signers(), work)

    def _signers(self) -> list[Signer]:
        place, genesis = open_network(self.folder)
        if self.key_file is not None:
            return [Signer(place, genesis, self.organisation or "", read_private_key(self.key_file))]
        known = admin_keys(place)
        first = [entry.name for entry in genesis.organisations if entry.name in known]
        names = list(dict.fromkeys([*first, *known])) if self.organisation is None else [self.organisation]
        if not names or not set(names) <= set(known):
            require_seen(place / "organisations", ADMIN_KEY_FILE, self.organisation)
            wanted = "any organisation" if self.organisation is None else repr(self.organisation)
            raise BlockRobotError(
                "ORGANISATION_KEY_NOT_FOUND", f"There is no key of {wanted} in {place / 'organisations'}."
            )
        return [Signer(place, genesis, name, read_private_key(known[name])) for name in names]


governing_options = as_one("admin", AdminOptions, folder_option, as_option, key_option)


@dataclass(frozen=True, slots=True)
class SubmittedAct:
    """A decision, the membership afterwards, and its proposal (None once closed)."""

    decision: Decision
    membership: MembershipView
    proposal: ProvedProposal | None


async def _read_act(
    client: NetworkClient, signer: Signer, decision: Decision, proposal_id: bytes | None
) -> SubmittedAct:
    after = await read_membership(client, signer.key)
    return SubmittedAct(decision, after, next((row for row in after.proposals if row.id == proposal_id), None))


def propose_once(
    signer: Signer,
    contract: str,
    kind: str,
    arguments: Mapping[str, Any],
    check: Check | None = None,
    prepare: Callable[[Governor], Awaitable[None]] | None = None,
) -> SubmittedAct:
    """Check and prepare if requested, propose unless open, wait for finality, read the result. Raises
    GOVERNANCE_PROPOSED_ALREADY.
    """

    async def run(client: NetworkClient) -> SubmittedAct:
        before, governor = await read_membership(client, signer.key), Governor(client, signer.key)
        _refuse_twice(signer, before, contract, kind, arguments)
        if check is not None:
            await check(client, before, kind, arguments)
        if prepare is not None:
            await prepare(governor)
        decision = await governor.propose(contract, kind, arguments)
        return await _read_act(client, signer, decision, decision.proposal_id)

    return with_client(signer, run)


def _refuse_twice(
    signer: Signer, membership: MembershipView, contract: str, kind: str, arguments: Mapping[str, Any]
) -> None:
    """Duplicates of open proposals would split the approvals. Exempt: revoking an own certificate, which takes effect at
    once.
    """
    if kind == "revoke_certificate" and signer.name in {"", arguments["organisation"]}:
        return
    for row in membership.proposals:
        is_same = all(row.arguments.get(name) == value for name, value in arguments.items() if name != "note")
        if (row.contract, row.kind) == (contract, kind) and is_same:
            command = f"blockrobot {_GROUPS[contract]} approve {shown_id(row.id)} --as"
            way = f"Approve it: {command} {signer.name or 'ORG'}"
            if signer.name in row.approvals:
                way = f"{signer.name} stands behind it already; another organisation approves it: {command} ORG"
            state = f"is proposed already, by {row.organisation}, and open until {format_time(row.expires_ms)}"
            raise BlockRobotError("GOVERNANCE_PROPOSED_ALREADY", f"{summary_of(row)} {state}. {way}")


async def _tell_closed(client: NetworkClient, key: PrivateKey, text: str) -> None:
    """Raises GOVERNANCE_PROPOSAL_CLOSED."""
    row = await find_closed(client, key, text)
    if row is not None:
        ended = {"executed": "was decided", "withdrawn": "was withdrawn", "expired": "expired"}.get(
            row.status, "closed"
        )
        sentence = f"The proposal {shown_id(row.id)} ({summary_of(row)}) {ended} at height {row.closed_height}."
        raise BlockRobotError("GOVERNANCE_PROPOSAL_CLOSED", sentence)


def decide_on_proposal(
    signer: Signer, contract: str, text: str, entry: str, check: Check | None = None
) -> tuple[SubmittedAct, ProvedProposal]:
    """By id prefix; check if requested, approve or withdraw."""

    async def run(client: NetworkClient) -> tuple[SubmittedAct, ProvedProposal]:
        before = await read_membership(client, signer.key)
        try:
            proposal = resolve_proposal([row for row in before.proposals if row.contract == contract], text)
        except BlockRobotError:
            await _tell_closed(client, signer.key, text)
            raise
        if check is not None:
            await check(client, before, proposal.kind, proposal.arguments)
        governor = Governor(client, signer.key)
        decision = await (governor.approve if entry == "approve" else governor.withdraw)(proposal)
        return await _read_act(client, signer, decision, proposal.id), proposal

    return with_client(signer, run)


# Telling


def command_group(contract: str) -> str:
    return _GROUPS[contract]


def shown_id(identifier: bytes) -> str:
    return identifier.hex()[:ID_SHOWN_CHARS]


def to_json(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, dict):
        return {str(name): to_json(item) for name, item in value.items()}
    return [to_json(item) for item in value] if isinstance(value, list | tuple) else value


def proposal_answer(row: ProvedProposal, needed: int) -> OpenProposal:
    return OpenProposal(
        id=row.id.hex(),
        kind=row.kind,
        arguments=to_json(dict(row.arguments)),
        organisation=row.organisation,
        approvals=list(row.approvals),
        needed=needed,
        height=row.height,
        expires_ms=row.expires_ms,
    )


def summary_of(row: ProvedProposal) -> str:
    arguments = row.arguments
    if row.kind == "set":
        return f"{arguments['name']} = {arguments['value']}"
    named = arguments.get("name") or arguments.get("node") or arguments.get("organisation")
    version = f" version {arguments['version']}" if "version" in arguments else ""
    return f"{row.kind.replace('_', '-')} {named}{version}"


def print_proposals(rows: list[ProvedProposal], needed: int, group: str) -> None:
    if not rows:
        console.print("No open proposals.")
        return
    table = plain_table("Open proposals", ["id", "what", "approved by", "of", "expires"])
    for row in rows:
        cells = [shown_id(row.id), summary_of(row), ", ".join(row.approvals), str(needed)]
        table.add_row(*map(escape, cells), format_date(row.expires_ms))
    console.print(table)
    console.print(f"Approve with: blockrobot {group} approve {shown_id(rows[0].id)} --as ORG")


def plain_table(title: str, columns: list[str]) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def report_decision(
    submitted: SubmittedAct, what: str, group: str, *, as_json: bool, needs_others: bool = True
) -> None:
    decision, proposal, needed = submitted.decision, submitted.proposal, submitted.membership.majority
    if as_json:
        print_answer(
            DecisionAnswer(
                height=decision.height,
                txid=decision.txid.hex(),
                executed=decision.executed,
                epoch=decision.epoch,
                proposal=None if proposal is None else proposal_answer(proposal, needed),
            )
        )
        return
    if proposal is not None:
        voices = f"{len(proposal.approvals)} of the {needed} organisations needed stand behind it"
        console.print(f"Proposed: {escape(what)}. Its id is {shown_id(proposal.id)}; {voices}.")
        console.print(
            "Next step: an admin of another organisation says "
            f"blockrobot {group} approve {shown_id(proposal.id)} --as ORG, by {format_time(proposal.expires_ms)}."
        )
        return
    state = "in force" if decision.executed or not needs_others else "final"
    console.print(f"{escape(what)}: {state} since height {decision.height}.")
    if decision.epoch is not None:
        console.print(f"Epoch {decision.epoch} begins with the block after that height.")


def withdraw_command(contract: str, what: str) -> click.Command:
    group = _GROUPS[contract]
    example = f"Example: blockrobot {group} withdraw 3fa2c19b07de --as hospital"

    @click.command(help=f"Take back {what} that your own organisation proposed.\n\n{example}")
    @click.argument("proposal")
    @governing_options
    @command_output
    def withdraw(proposal: str, admin: AdminOptions, as_json: bool) -> None:
        submitted, row = decide_on_proposal(admin.signer(), contract, proposal, "withdraw")
        report_decision(submitted, f"Withdrawal of {summary_of(row)}", group, as_json=as_json, needs_others=False)

    return withdraw
