"""What clients asked, were told and read, and whether one chain can have told them that. Must never ask a node itself.

It judges by nothing but the clients' own books, so it holds whatever nodes say of themselves: everything acknowledged is
there exactly once, in its place, on every node that was read; the places keep the order in which clients heard of them;
no reader is led back; and every read shows just the writes up to its height.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

Place = tuple[int, int]
"""Height of the block, index in it."""


@dataclass(frozen=True)
class Acknowledged:
    """A record that a client was told is final: where, and when it asked and was told (s of the test's clock)."""

    client: str
    record_id: bytes
    txid: bytes
    height: int
    index: int
    block_id: bytes
    asked_s: float
    told_s: float

    @property
    def place(self) -> Place:
        """Where in the chain it stands."""
        return self.height, self.index


@dataclass(frozen=True)
class Seen:
    """What a state says of one record: the block and the transaction that wrote it."""

    height: int
    txid: bytes


@dataclass(frozen=True)
class Read:
    """What a client read, proved, from one finalized state.

    `counts` says how many records this state has of a client, `records` what it says of a record (None: it has none).
    """

    client: str
    node: str
    height: int
    timestamp_ms: int
    asked_s: float
    told_s: float
    counts: Mapping[str, int] = field(default_factory=dict)
    records: Mapping[bytes, Seen | None] = field(default_factory=dict)


@dataclass
class ClientHistory:
    """The books of all clients of one story. `given_up` holds records that were asked for and refused for good."""

    writes: list[Acknowledged] = field(default_factory=list)
    reads: list[Read] = field(default_factory=list)
    given_up: set[bytes] = field(default_factory=set)

    def violations(self) -> list[str]:
        """Return a sentence for everything that no one chain can have told these clients."""
        found = [*self._doubled(), *self._reordered(), *self._forked()]
        found += [line for client in sorted({read.client for read in self.reads}) for line in self._led_back(client)]
        return found + [line for read in self.reads for line in self._misread(read)]

    def unread(self, nodes: Iterable[str]) -> list[str]:
        """Return a sentence for every acknowledged record that was not read from one of these nodes afterwards."""
        told_s = {write.record_id: write.told_s for write in self.writes}
        read_from = {
            (read.node, record_id)
            for read in self.reads
            for record_id in read.records
            if read.asked_s >= told_s.get(record_id, 0.0)
        }
        return [
            f"record {_short(record_id)} was never looked up at {node}"
            for node in nodes
            for record_id in told_s
            if (node, record_id) not in read_from
        ]

    # What is acknowledged

    def _doubled(self) -> Iterable[str]:
        """Every acknowledged record has one transaction and one place, and shares them with no other."""
        for what in ("record_id", "txid", "place"):
            seen: set[object] = set()
            for write in self.writes:
                value = getattr(write, what)
                if value in seen:
                    yield f"two acknowledgements have one {what}: {_short(write.record_id)} at {write.place}"
                seen.add(value)

    def _reordered(self) -> Iterable[str]:
        """Whatever any client asked for after any client was told of something stands behind that in the chain."""
        told = sorted(self.writes, key=lambda write: write.told_s)
        newest: Place = (-1, -1)
        position = 0
        for write in sorted(self.writes, key=lambda write: write.asked_s):
            while position < len(told) and told[position].told_s < write.asked_s:
                newest = max(newest, told[position].place)
                position += 1
            if write.place < newest:
                yield f"{_short(write.record_id)} at {write.place} was asked for after {newest} was acknowledged"

    def _forked(self) -> Iterable[str]:
        """Of each height all clients know one block, by its id and by its time."""
        blocks: dict[int, bytes] = {}
        for write in self.writes:
            if blocks.setdefault(write.height, write.block_id) != write.block_id:
                yield f"clients were told of two blocks at height {write.height}"
        times: dict[int, int] = {}
        for read in self.reads:
            if times.setdefault(read.height, read.timestamp_ms) != read.timestamp_ms:
                yield f"clients read two states at height {read.height}"

    # What is read

    def _led_back(self, client: str) -> Iterable[str]:
        """A client's reads never go back behind an earlier read or what it was told before; what it counts only grows."""
        own = sorted((write for write in self.writes if write.client == client), key=lambda write: write.told_s)
        known, position = -1, 0
        counted: dict[str, int] = {}
        for read in sorted((read for read in self.reads if read.client == client), key=lambda read: read.asked_s):
            while position < len(own) and own[position].told_s < read.asked_s:
                known = max(known, own[position].height)
                position += 1
            if read.height < known:
                yield f"{client} was led back from height {known} to {read.height} by {read.node}"
            known = max(known, read.height)
            for whose, count in read.counts.items():
                if count < counted.get(whose, 0):
                    yield f"{client} read {count} records of {whose} after {counted[whose]}"
                counted[whose] = count

    def _misread(self, read: Read) -> Iterable[str]:
        """One read shows the acknowledged writes up to its height, each in its place, and nothing else."""
        where = f"{read.node} at height {read.height}"
        writes = {write.record_id: write for write in self.writes}
        for whose, count in read.counts.items():
            expected = sum(write.client == whose and write.height <= read.height for write in self.writes)
            if count != expected:
                yield f"{where} has {count} records of {whose}, acknowledged are {expected}"
        for record_id, seen in read.records.items():
            write = writes.get(record_id)
            if write is None:
                if seen is not None and record_id in self.given_up:
                    yield f"{where} has {_short(record_id)}, which was refused"
            elif seen is None and write.height <= read.height:
                yield f"{where} has lost {_short(record_id)}, which was final at height {write.height}"
            elif seen is not None and (seen.height, seen.txid) != (write.height, write.txid):
                yield f"{where} has {_short(record_id)} at height {seen.height}, acknowledged was {write.height}"
            elif seen is not None and (write.height > read.height or write.asked_s > read.told_s):
                yield f"{where} shows {_short(record_id)} before it was there"


def _short(record_id: bytes) -> str:
    return record_id.hex()[:8]
