"""State of the contract `membership`: organisations, nodes and proposals."""

from __future__ import annotations

from typing import Any, Literal

from consensus.state.keys import HASH_BYTES, KEY_BYTES, TEXT, ListRow, Prefix, Reader, Row, StateKey

MEMBERSHIP = "membership"
SERIAL_BYTES = 20


class OrganisationRow(Row, frozen=True):
    """An organisation, active or removed."""

    name: str
    ca_certificate: str
    status: Literal["active", "removed"]
    since_height: int


class NodeRow(Row, frozen=True):
    """A node, active or removed; absent keys are empty."""

    name: str
    organisation: str
    host: str
    p2p_port: int
    api_url: str
    producer_key: bytes
    producer_possession: bytes
    custodian_key: bytes
    status: Literal["active", "removed"]
    since_height: int


class RevokedRow(Row, frozen=True):
    """The height at which a certificate was revoked."""

    height: int


class GovernanceProposalRow(Row, frozen=True):
    """An organisations' decision: its supporters and their keys (`keys_numbers`)."""

    contract: str
    kind: str
    arguments: dict[str, Any]
    organisation: str
    approvals: list[str]
    keys_numbers: dict[str, int]
    time: int
    expires_ms: int
    height: int
    status: str
    closed_height: int


class OpenProposalRow(ListRow, frozen=True):
    """An open proposal: id, proposer and expiry (ms)."""

    proposal_id: bytes
    organisation: str
    expires_ms: int


ORGANISATION: Prefix[OrganisationRow] = Prefix(MEMBERSHIP, "org/", (TEXT,), OrganisationRow)
NODE: Prefix[NodeRow] = Prefix(MEMBERSHIP, "node/", (TEXT,), NodeRow)
REVOKED: Prefix[RevokedRow] = Prefix(MEMBERSHIP, "revoked/", (TEXT, b"/", SERIAL_BYTES), RevokedRow)
NODE_OF_KEY: Prefix[str] = Prefix(MEMBERSHIP, "key/", (KEY_BYTES,), str)
"""The node that has or had a key."""
ORGANISATIONS: StateKey[list[str]] = StateKey(MEMBERSHIP, "organisations", list[str])
"""The active organisations, sorted."""
NODES: StateKey[list[str]] = StateKey(MEMBERSHIP, "nodes", list[str])
"""The active nodes, sorted."""
NODES_OF: Prefix[list[str]] = Prefix(MEMBERSHIP, "nodes-of/", (TEXT,), list[str])
"""The active nodes of an organisation, sorted."""
KEYS_NUMBER: Prefix[int] = Prefix(MEMBERSHIP, "keys-number/", (TEXT,), int)
"""How often an organisation got keys."""
PROPOSAL: Prefix[GovernanceProposalRow] = Prefix(MEMBERSHIP, "proposal/", (HASH_BYTES,), GovernanceProposalRow)
OPEN: StateKey[list[OpenProposalRow]] = StateKey(MEMBERSHIP, "open", list[OpenProposalRow])
"""The open proposals, in the order of their opening."""
CLOSED: StateKey[list[bytes]] = StateKey(MEMBERSHIP, "closed", list[bytes])
"""The last 32 that are open no more."""
LAYOUT = (
    ORGANISATION,
    NODE,
    REVOKED,
    NODE_OF_KEY,
    ORGANISATIONS,
    NODES,
    NODES_OF,
    KEYS_NUMBER,
    PROPOSAL,
    OPEN,
    CLOSED,
)


def active_organisations(state: Reader) -> list[str]:
    return ORGANISATIONS.read(state) or []


def active_nodes(state: Reader) -> list[str]:
    return NODES.read(state) or []
