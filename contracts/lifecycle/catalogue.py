"""Resolves which contracts are active in a state."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from threading import Lock

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.state.keys import Prefix, Reader
from consensus.state.lifecycle import (
    MACHINE_SOURCE,
    MACHINE_SOURCE_PART,
    MACHINE_TABLE,
    SOURCE,
    SOURCE_PART,
    SourceRow,
    TableRow,
)
from contracts.execution.call_host import CallHost
from contracts.lifecycle.changes import is_count, read_value
from contracts.lifecycle.registry import find_shipped_source
from contracts.vm import CompiledContract
from contracts.vm.compiler.compile_cache import compile_once, compute_source_hash

SOURCE_PART_BYTES = 6000
SOURCE_PARTS_MAX_COUNT = 64
TABLES_KEPT_COUNT = 4


class ActiveContracts(dict[str, CompiledContract]):
    """Active contracts by name; `versions` includes disabled ones, `since` is each one's height."""

    def __init__(self, contracts: Mapping[str, CompiledContract], table: TableRow) -> None:
        super().__init__(contracts)
        self.disabled = frozenset(name for name, row in table.items() if not row.enabled)
        self.versions = {name: row.version for name, row in table.items()}
        self.since = {name: row.since_height for name, row in table.items()}


def read_source_of(state: Reader, source_hash: bytes) -> str:
    """Raises STORAGE_DAMAGED if it is missing."""
    source = find_source(state, source_hash)
    if source is None:
        raise BlockRobotError("STORAGE_DAMAGED", f"The state lacks the source {source_hash.hex()} of a contract.")
    return source


def find_source(state: Reader, source_hash: bytes) -> str | None:
    shipped = find_shipped_source(source_hash)
    if shipped is not None:
        return shipped
    for place, part in ((MACHINE_SOURCE, MACHINE_SOURCE_PART), (SOURCE, SOURCE_PART)):
        data = _join_parts(state, source_hash, place, part)
        if compute_source_hash(data) == source_hash:
            # Other bytes than text of this hash are no source.
            try:
                return data.decode()
            except UnicodeDecodeError:
                return None
    return None


def _join_parts(state: Reader, source_hash: bytes, place: Prefix[SourceRow], part: Prefix[bytes]) -> bytes:
    entry = read_value(state, place.key(source_hash))
    count = entry.get("parts") if isinstance(entry, dict) else 0
    if not is_count(count) or count > SOURCE_PARTS_MAX_COUNT:
        return b""
    parts = [read_value(state, part.key(source_hash, number)) for number in range(count)]
    return b"".join(parts) if all(isinstance(each, bytes) for each in parts) else b""


def keep_source(host: CallHost, source: str, source_hash: bytes) -> None:
    """Store an activated version's source under keys that no contract reaches."""
    place = MACHINE_SOURCE.key(source_hash)
    if find_shipped_source(source_hash) is None and host.get(place) is None:
        data = source.encode()
        parts = [data[first : first + SOURCE_PART_BYTES] for first in range(0, len(data), SOURCE_PART_BYTES)]
        for number, part in enumerate(parts):
            host.put(MACHINE_SOURCE_PART.key(source_hash, number), encode_value(part))
        host.put(place, encode_value({"parts": len(parts), "size_bytes": len(data)}))


class Catalogue:
    """Finds a state's contracts; caches the newest tables only for their own state."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[bytes, ActiveContracts] = OrderedDict()
        self._compiled: dict[tuple[str, bytes], CompiledContract] = {}

    def active(self, state: Reader) -> ActiveContracts:
        """Return the active contracts; for a block, after its due changes took effect.

        Raises GENESIS_INVALID if none are named, STORAGE_DAMAGED if a source is missing.
        """
        data = state.get(MACHINE_TABLE.flat)
        if data is None:
            raise BlockRobotError("GENESIS_INVALID", "The state names no contracts.")
        with self._lock:
            known = self._kept.get(data)
            if known is None:
                known = self._kept[data] = self._read(state, MACHINE_TABLE.decode(data))
                if len(self._kept) > TABLES_KEPT_COUNT:
                    self._kept.popitem(last=False)
        return known

    def _read(self, state: Reader, table: TableRow) -> ActiveContracts:
        wanted = {(name, row.source_hash) for name, row in table.items() if row.enabled}
        self._compiled = {place: self._compiled.get(place) or compile_named(state, *place) for place in sorted(wanted)}
        return ActiveContracts({name: compiled for (name, _), compiled in self._compiled.items()}, table)


def compile_named(state: Reader, name: str, source_hash: bytes) -> CompiledContract:
    """Raises STORAGE_DAMAGED."""
    return compile_once(read_source_of(state, source_hash), name)
