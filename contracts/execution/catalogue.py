"""Which contracts answer, as the state says: the mapping that blocks and views run with. Must never know of one elsewhere.

The contract `lifecycle` keeps the table, and the machine reads it at the beginning of each block. Sources that ship with
BlockRobot are found by their hash in the package, all others in the state.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from threading import Lock
from typing import Any, Protocol

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, u32
from contracts.execution.registry import find_shipped_source
from contracts.vm import CompiledContract
from contracts.vm.sources import compile_once, compute_source_hash

TABLE_KEY = b"lifecycle\x00table"
SOURCE_PREFIX = b"lifecycle\x00source/"
TABLES_KEPT_COUNT = 4


class Reader(Protocol):
    """Whatever can be asked for the value under a flat key."""

    def get(self, key: bytes, /) -> bytes | None:
        """Return the encoded value, or None."""


class ActiveContracts(dict[str, CompiledContract]):
    """The contracts that answer, by name. `versions` has the disabled ones too; `since` is the height of each."""

    def __init__(self, contracts: Mapping[str, CompiledContract], table: Mapping[str, Any]) -> None:
        super().__init__(contracts)
        self.disabled = frozenset(name for name, row in table.items() if not row[2])
        self.versions = {name: row[0] for name, row in table.items()}
        self.since = {name: row[3] for name, row in table.items()}


def read_source_of(state: Reader, source_hash: bytes) -> str:
    """Return a source by its hash. Raises STORAGE_DAMAGED if the state names one that nobody has."""
    shipped = find_shipped_source(source_hash)
    if shipped is not None:
        return shipped
    entry = state.get(SOURCE_PREFIX + source_hash)
    parts = 0 if entry is None else decode_value(entry)["parts"]
    found = [state.get(SOURCE_PREFIX + source_hash + b"/" + u32(place)) for place in range(parts)]
    data = b"".join(decode_value(part) for part in found if part is not None)
    if not found or compute_source_hash(data) != source_hash:
        raise BlockRobotError("STORAGE_DAMAGED", f"The state lacks the source {source_hash.hex()} of a contract.")
    return data.decode()


class Catalogue:
    """Finds the contracts of a state. It remembers the newest tables, and never answers for another state's."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[bytes, ActiveContracts] = OrderedDict()
        self._compiled: dict[tuple[str, bytes], CompiledContract] = {}

    def active(self, state: Reader) -> ActiveContracts:
        """Return the contracts that answer on this state; for a block, after what was due with it took effect.

        Raises GENESIS_INVALID if the state names none, STORAGE_DAMAGED if a source is missing.
        """
        data = state.get(TABLE_KEY)
        if data is None:
            raise BlockRobotError("GENESIS_INVALID", "The state names no contracts.")
        with self._lock:
            known = self._kept.get(data)
            if known is None:
                known = self._kept[data] = self._read(state, decode_value(data))
                if len(self._kept) > TABLES_KEPT_COUNT:
                    self._kept.popitem(last=False)
        return known

    def _read(self, state: Reader, table: Mapping[str, Any]) -> ActiveContracts:
        """Compile what the table names, except what the table before it named too."""
        wanted = {(name, row[1]) for name, row in table.items() if row[2]}
        self._compiled = {place: self._compiled.get(place) or compile_named(state, *place) for place in sorted(wanted)}
        return ActiveContracts({name: compiled for (name, _), compiled in self._compiled.items()}, table)


def compile_named(state: Reader, name: str, source_hash: bytes) -> CompiledContract:
    """Return a contract by the hash of its source, ready to run. Raises STORAGE_DAMAGED."""
    return compile_once(read_source_of(state, source_hash), name)
