"""Joint decisions of organisations: proved reads, and `Governor` for admin calls."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from clients.sdk.chain.proved_rows import read_proved
from clients.sdk.network_client import FinalReceipt, NetworkClient
from consensus.chain.epoch_settings import ChainSettings, Epoch
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state import producers
from consensus.state.membership import (
    CLOSED,
    KEYS_NUMBER,
    NODE,
    NODES,
    OPEN,
    ORGANISATION,
    ORGANISATIONS,
    PROPOSAL,
    GovernanceProposalRow,
    NodeRow,
    OrganisationRow,
)
from consensus.state.settings import CUSTODY_COPIES, QUOTA, QUOTA_NAMES, UploadQuotas, quotas_of
from consensus.visible_text import one_entry

ID_PREFIX_MIN_CHARS = 6
_CONTRACT_NAMED = re.compile(r"^(In contract [a-z]+: )+")
_ERROR_OF = {
    "NOT_AN_ADMIN": "GOVERNANCE_NOT_ADMIN",
    "NOT_THE_PROPOSER": "GOVERNANCE_NOT_ADMIN",
    "APPROVED_ALREADY": "GOVERNANCE_APPROVED_ALREADY",
    "PROPOSAL_UNKNOWN": "GOVERNANCE_PROPOSAL_CLOSED",
    "PROPOSAL_CLOSED": "GOVERNANCE_PROPOSAL_CLOSED",
    "PROPOSAL_EXPIRED": "GOVERNANCE_PROPOSAL_CLOSED",
    "PROPOSAL_OF_ANOTHER": "GOVERNANCE_PROPOSAL_CLOSED",
    "LAST_PRODUCER": "GOVERNANCE_WOULD_STOP_CHAIN",
    "LAST_CUSTODIAN": "GOVERNANCE_WOULD_STOP_CHAIN",
    "LAST_ADMINS": "GOVERNANCE_WOULD_STOP_CHAIN",
    "VALUE_WRONG": "GOVERNANCE_SETTING_REFUSED",
    "SETTING_UNKNOWN": "GOVERNANCE_SETTING_REFUSED",
}


class ProvedProposal(GovernanceProposalRow, frozen=True):
    """A proposal with its id (32 bytes); approvals by replaced keys are excluded."""

    id: bytes


class ProvedCandidate(producers.CandidateRow, frozen=True):
    """A candidate with its key. `turn`: schedule position, None without seat; `leads`: not leaderless."""

    key: bytes
    turn: int | None
    leads: bool


@dataclass(frozen=True, slots=True)
class ProducersView:
    """The decided epoch, its decision height, and candidates, seated first."""

    height: int
    timestamp_ms: int
    epoch: Epoch
    since_height: int
    max_producers: int
    candidates: tuple[ProvedCandidate, ...]
    quotas: UploadQuotas = field(default_factory=UploadQuotas)
    custody_copies: int = 0


@dataclass(frozen=True, slots=True)
class MembershipView:
    """Active organisations and nodes, and open proposals, at one height."""

    height: int
    timestamp_ms: int
    organisations: tuple[OrganisationRow, ...]
    nodes: tuple[NodeRow, ...]
    proposals: tuple[ProvedProposal, ...]

    @property
    def majority(self) -> int:
        return len(self.organisations) // 2 + 1


def _epoch_of(row: producers.EpochRow) -> Epoch:
    settings: dict[str, Any] = dict(row.settings)
    return Epoch(row.number, tuple(row.producers), tuple(row.leaderless), ChainSettings(**settings))


def _proposal(proposal_id: bytes, row: GovernanceProposalRow, keys_numbers: Mapping[str, int | None]) -> ProvedProposal:
    numbers = row.keys_numbers
    good = [name for name in row.approvals if name in keys_numbers and numbers[name] == keys_numbers[name]]
    return ProvedProposal(**msgspec.structs.asdict(row) | {"approvals": good}, id=proposal_id)


async def read_membership(client: NetworkClient, reader: PrivateKey) -> MembershipView:
    """Read the proved membership. Raises PROOF_*."""
    await client.catch_up(reader)
    found = (await read_proved(client, [ORGANISATIONS.flat, NODES.flat, OPEN.flat], reader)).values
    names, nodes = ORGANISATIONS.among(found) or [], NODES.among(found) or []
    opened = [row.proposal_id for row in OPEN.among(found) or []]
    of_names = [key for name in names for key in (ORGANISATION.key(name), KEYS_NUMBER.key(name))]
    of_others = [*map(NODE.key, nodes), *map(PROPOSAL.key, opened)]
    state = await read_proved(client, [*of_names, *of_others], reader)
    numbers = {name: KEYS_NUMBER.among(state.values, name) for name in names}
    proposals = [(proposal_id, PROPOSAL.among(state.values, proposal_id)) for proposal_id in opened]
    return MembershipView(
        height=state.height,
        timestamp_ms=state.timestamp_ms,
        organisations=tuple(row for name in names if (row := ORGANISATION.among(state.values, name)) is not None),
        nodes=tuple(node for name in nodes if (node := NODE.among(state.values, name)) is not None),
        proposals=tuple(
            _proposal(proposal_id, row, numbers)
            for proposal_id, row in proposals
            if row is not None and row.status == "open" and row.expires_ms > state.timestamp_ms
        ),
    )


async def read_producers(client: NetworkClient, reader: PrivateKey) -> ProducersView:
    await client.catch_up(reader)
    index = [producers.EPOCH.flat, producers.MAX_PRODUCERS.flat, producers.KEYS.flat]
    found = (await read_proved(client, [*index, *map(QUOTA.key, (*QUOTA_NAMES, CUSTODY_COPIES))], reader)).values
    decided, maximum = producers.EPOCH.among(found), producers.MAX_PRODUCERS.among(found)
    if decided is None or maximum is None:
        raise BlockRobotError("NOT_FOUND", "This chain has no contract for its producers; it is older than governance.")
    epoch = _epoch_of(decided)
    keys = list(dict.fromkeys([*epoch.producers, *(producers.KEYS.among(found) or [])]))
    state = await read_proved(client, [producers.CANDIDATE.key(key) for key in keys], reader)
    turns = {key: turn for turn, key in enumerate(epoch.producers)}
    rows = [
        ProvedCandidate(
            **msgspec.structs.asdict(row),
            key=key,
            turn=turns.get(key),
            leads=key in turns and turns[key] not in epoch.leaderless,
        )
        for key in keys
        if (row := producers.CANDIDATE.among(state.values, key)) is not None
    ]
    return ProducersView(
        height=state.height,
        timestamp_ms=state.timestamp_ms,
        epoch=epoch,
        since_height=decided.height,
        max_producers=maximum,
        candidates=tuple(rows),
        quotas=quotas_of({name: mib for name in QUOTA_NAMES if (mib := QUOTA.among(found, name)) is not None}),
        custody_copies=QUOTA.among(found, CUSTODY_COPIES) or 0,
    )


def settings_in_force(view: ProducersView) -> dict[str, int | str]:
    values = {name: getattr(view.epoch.settings, name) for name in ChainSettings.__struct_fields__}
    quotas = {name: getattr(view.quotas, name) for name in QUOTA_NAMES}
    return {**values, "max_producers": view.max_producers, **quotas, CUSTODY_COPIES: view.custody_copies}


def resolve_proposal(proposals: Iterable[ProvedProposal], text: str) -> ProvedProposal:
    """Find by id prefix (six or more hex digits). Raises GOVERNANCE_PROPOSAL_CLOSED if none or several."""
    wanted = text.strip().lower()
    found = [row for row in proposals if len(wanted) >= ID_PREFIX_MIN_CHARS and row.id.hex().startswith(wanted)]
    if len(found) != 1:
        raise BlockRobotError("GOVERNANCE_PROPOSAL_CLOSED", f"There is no open proposal {text!r}.")
    return found[0]


async def find_closed(client: NetworkClient, reader: PrivateKey, text: str) -> ProvedProposal | None:
    wanted = text.strip().lower()
    closed = CLOSED.among((await read_proved(client, [CLOSED.flat], reader)).values) or []
    found = [one for one in closed if len(wanted) >= ID_PREFIX_MIN_CHARS and one.hex().startswith(wanted)]
    if len(found) != 1:
        return None
    row = PROPOSAL.among((await read_proved(client, [PROPOSAL.key(found[0])], reader)).values, found[0])
    return None if row is None else _proposal(found[0], row, {})


@dataclass(frozen=True, slots=True)
class Decision:
    """Result of a final call. `executed`: a proposal took effect; `due_height`, `due_kind` (activate, disable),
    `due_version`: pending contract change; `epoch`: decided by block `height`.
    """

    height: int
    txid: bytes
    proposal_id: bytes | None
    executed: bool
    epoch: int | None
    due_height: int | None = None
    due_kind: str = ""
    due_version: int = 0


def _decision_of(receipt: FinalReceipt) -> Decision:
    proposed = receipt.event_data("membership", "proposed")
    epochs = receipt.event_data("producers", "epoch")
    scheduled = receipt.event_data("lifecycle", "scheduled")
    due = scheduled[-1] if scheduled else {}
    return Decision(
        height=receipt.height,
        txid=receipt.txid,
        proposal_id=proposed[0]["proposal_id"] if proposed else None,
        executed=bool(receipt.event_data("membership", "executed")),
        epoch=epochs[-1]["number"] if epochs else None,
        due_height=due.get("height"),
        due_kind=due.get("kind", ""),
        due_version=due.get("version", 0),
    )


class Governor:
    """An organisation's admin. Calls return after a proved final receipt."""

    def __init__(self, client: NetworkClient, key: PrivateKey) -> None:
        self._client = client
        self._key = key

    async def _call(self, contract: str, entry: str, arguments: list[Any]) -> Decision:
        """Raises GOVERNANCE_*, or the network's error."""
        transaction = self._client.transactions.build(self._key, contract, entry, arguments)
        try:
            receipt = await self._client.submit_and_wait(transaction)
        except BlockRobotError as error:
            if error.code == "SENDER_NOT_ADMITTED":
                raise BlockRobotError("GOVERNANCE_NOT_ADMIN") from None
            raise
        if not receipt.ok:
            sentence = one_entry(_CONTRACT_NAMED.sub("", receipt.message))
            otherwise = "GOVERNANCE_CONTRACT_REFUSED" if contract == "lifecycle" else "GOVERNANCE_REFUSED"
            code = _ERROR_OF.get(receipt.code, otherwise)
            raise BlockRobotError(code, sentence or receipt.code, contract_code=receipt.code)
        return _decision_of(receipt)

    async def propose(self, contract: str, kind: str, arguments: Mapping[str, Any]) -> Decision:
        """Propose a change by the contract `membership`, `settings` (kind `set`) or `lifecycle`."""
        values = [arguments["name"], arguments["value"]] if contract == "settings" else [kind, dict(arguments)]
        return await self._call(contract, "propose", values)

    async def upload_part(self, source_hash: bytes, parts: int, place: int, data: bytes) -> Decision:
        """At most 6,000 bytes; `source_hash` covers the whole."""
        return await self._call("lifecycle", "upload", [source_hash, parts, place, data])

    async def check_upload(self, source_hash: bytes) -> Decision:
        """Compile it once; proposals report its errors."""
        return await self._call("lifecycle", "check_upload", [source_hash])

    async def approve(self, proposal: ProvedProposal) -> Decision:
        return await self._call(proposal.contract, "approve", [proposal.id])

    async def withdraw(self, proposal: ProvedProposal) -> Decision:
        return await self._call("membership", "withdraw", [proposal.id])

    async def vote(self, entry: str, key: bytes) -> Decision:
        """Vote on a producer key (33 bytes): `propose`, `approve`, `withdraw`, or `remove` (own: one vote suffices)."""
        return await self._call("producers", entry, [key])
