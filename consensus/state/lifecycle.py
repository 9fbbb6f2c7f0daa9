"""State of the contract `lifecycle`, whose rows the machine distrusts: versions, changes, sources."""

from __future__ import annotations

from typing import Any

from consensus.state.keys import HASH_BYTES, TEXT, U32_BYTES, ListRow, Prefix, Row, StateKey

LIFECYCLE = "lifecycle"
MACHINE = "machine"


class ChangeRow(Row, frozen=True):
    """A change due at a height or a time (ms)."""

    kind: str
    name: str
    version: int
    from_height: int
    from_ms: int


class TrialRow(ChangeRow, frozen=True):
    """A trial: `version` with its source returns when it ends."""

    source_hash: bytes


class ContractEntryRow(ListRow, frozen=True):
    """An entry of a version: parameters are (name, type), of which the first `required` have to be given."""

    name: str
    kind: str
    params: list[tuple[str, str]]
    required: int
    returns: str


class VersionRow(Row, frozen=True):
    """A contract version; `status` is approved, active, superseded, disabled or failed."""

    source_hash: bytes
    size_bytes: int
    entries: list[ContractEntryRow]
    migrates: bool
    note: str
    organisation: str
    proposal_id: bytes
    approved_height: int
    status: str
    since_height: int
    failure: str


class SourceRow(Row, frozen=True):
    """The number of parts of a source."""

    parts: int
    size_bytes: int


class UploadRow(Row, frozen=True):
    """A source being uploaded, and its present parts."""

    source_hash: bytes
    parts: int
    places: list[int]


class ContractRow(ListRow, frozen=True):
    """A contract's version in force since a height."""

    version: int
    source_hash: bytes
    enabled: bool
    since_height: int


TableRow = dict[str, ContractRow]
Verdict = tuple[str, dict[str, Any]]
"""What is wrong with a source (empty: nothing), and the facts of it."""

DUE: StateKey[list[ChangeRow]] = StateKey(LIFECYCLE, "due", list[ChangeRow])
"""What the machine is asked to do."""
TABLE: StateKey[TableRow] = StateKey(LIFECYCLE, "table", TableRow)
"""A copy of the machine's, which it never reads."""
TRIALS: StateKey[list[TrialRow]] = StateKey(LIFECYCLE, "trials", list[TrialRow])
"""A copy of the machine's, which it never reads."""
VERSIONS: Prefix[int] = Prefix(LIFECYCLE, "versions/", (TEXT,), int)
"""How many versions a contract has."""
VERSION: Prefix[VersionRow] = Prefix(LIFECYCLE, "version/", (TEXT, b"/", U32_BYTES), VersionRow)
SOURCE: Prefix[SourceRow] = Prefix(LIFECYCLE, "source/", (HASH_BYTES,), SourceRow)
"""An approved source by its hash; what ships with BlockRobot is found in the package."""
SOURCE_PART: Prefix[bytes] = Prefix(LIFECYCLE, "source/", (HASH_BYTES, b"/", U32_BYTES), bytes)
"""One part of it."""
UPLOADS: Prefix[list[UploadRow]] = Prefix(LIFECYCLE, "uploads/", (TEXT,), list[UploadRow])
"""What an organisation is uploading."""
UPLOAD_PART: Prefix[bytes] = Prefix(LIFECYCLE, "upload/", (TEXT, b"/", HASH_BYTES, U32_BYTES), bytes)
"""By organisation, and by hash and number: one part of an upload."""
VERDICT: Prefix[Verdict] = Prefix(LIFECYCLE, "verdict/", (TEXT, b"/", HASH_BYTES), Verdict)
"""By organisation and hash: what is wrong with a source (empty: nothing), and the facts of it."""
MACHINE_TABLE: StateKey[TableRow] = StateKey(MACHINE, "table", TableRow)
"""The contracts that were ever in force, by name."""
MACHINE_TRIALS: StateKey[list[TrialRow]] = StateKey(MACHINE, "trials", list[TrialRow])
"""The trials of contracts that govern, each with the version that comes back."""
MACHINE_SOURCE: Prefix[SourceRow] = Prefix(MACHINE, "source/", (HASH_BYTES,), SourceRow)
"""A source of a version that was ever in force and does not ship."""
MACHINE_SOURCE_PART: Prefix[bytes] = Prefix(MACHINE, "source/", (HASH_BYTES, b"/", U32_BYTES), bytes)
"""One part of it."""
LAYOUT = (
    DUE,
    TABLE,
    TRIALS,
    VERSIONS,
    VERSION,
    SOURCE,
    SOURCE_PART,
    UPLOADS,
    UPLOAD_PART,
    VERDICT,
    MACHINE_TABLE,
    MACHINE_TRIALS,
    MACHINE_SOURCE,
    MACHINE_SOURCE_PART,
)
