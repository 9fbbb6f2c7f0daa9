"""JSON documents about contracts."""

from __future__ import annotations

from consensus.api_documents import Document, Hex32, HexBytes


class ContractSummary(Document, frozen=True):
    """A contract: version in force, source hash, activity and since when, versions."""

    name: str
    version: int
    source_hash: Hex32
    enabled: bool
    since_height: int
    versions: int


class ContractChange(Document, frozen=True):
    """A pending change: activate, disable, keep or return, from a height or a time in ms (else 0)."""

    kind: str
    name: str
    version: int
    from_height: int
    from_ms: int


class ContractsAnswer(Document, frozen=True):
    """All contracts at the newest finalized height, and pending changes."""

    height: int
    contracts: list[ContractSummary]
    due: list[ContractChange]


class ContractParameter(Document, frozen=True):
    """A parameter of an entry, with its type as the source writes it."""

    name: str
    type: str


class ContractEntry(Document, frozen=True):
    """An ABI entry, `export` or `view`; parameters after the first `required` are optional."""

    name: str
    kind: str
    parameters: list[ContractParameter]
    required: int
    returns: str


class ContractVersionAnswer(Document, frozen=True):
    """A contract version. `status`: approved, active, superseded, disabled or failed (see `failure`)."""

    height: int
    name: str
    version: int
    status: str
    since_height: int
    failure: str
    source_hash: Hex32
    size_bytes: int
    migrates: bool
    note: str
    organisation: str
    proposal_id: HexBytes
    approved_height: int
    abi: list[ContractEntry]
    source: str
