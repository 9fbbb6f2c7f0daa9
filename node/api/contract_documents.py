"""The JSON documents about contracts."""

from __future__ import annotations

from node.api.documents import Document, Hex32, HexBytes


class ContractSummary(Document, frozen=True):
    """A contract: the version in force, the hash of its source, whether it answers and since when, its versions."""

    name: str
    version: int
    source_hash: Hex32
    enabled: bool
    since_height: int
    versions: int


class ContractChange(Document, frozen=True):
    """A change that waits: `kind` is activate, disable, keep or return; from a height, or from a time in ms (else 0)."""

    kind: str
    name: str
    version: int
    from_height: int
    from_ms: int


class ContractsAnswer(Document, frozen=True):
    """All contracts at the newest finalized height, and the changes that are due."""

    height: int
    contracts: list[ContractSummary]
    due: list[ContractChange]


class ContractParameter(Document, frozen=True):
    """A parameter of an entry, with its type as the source writes it."""

    name: str
    type: str


class ContractEntry(Document, frozen=True):
    """An entry of the ABI: an `export` or a `view`; the parameters after the first `required` may be left out."""

    name: str
    kind: str
    parameters: list[ContractParameter]
    required: int
    returns: str


class ContractVersionAnswer(Document, frozen=True):
    """A version of a contract. `status` is approved, active, superseded, disabled or failed (then `failure` says why)."""

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
