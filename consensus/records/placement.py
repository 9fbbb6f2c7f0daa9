"""Which custodians keep a clip: rendezvous hashing over the members, weighted by their declared room.

Schindler's method: the custodians with the highest w / -ln(u), with u in (0, 1) from a hash of record and custodian. Its
logarithm is `decimal`'s, which rounds correctly, so every machine finds the same order.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Context, Decimal

from consensus.primitives.hashing import tagged_hash

COPIES_DEFAULT_COUNT = 3
"""Of a clip, while the organisations decided nothing else; with fewer custodians each keeps all."""

_TAG = "blockrobot/placement"
_DRAW_BYTES = 8
_DRAWS = Decimal(1 << (8 * _DRAW_BYTES + 1))
_EXACT = Context(prec=28, rounding=ROUND_HALF_EVEN)


def _draw(record_id: bytes, custodian: bytes) -> int:
    return int.from_bytes(tagged_hash(_TAG, record_id, custodian)[:_DRAW_BYTES], "big")


def _score(draw: int, room: int) -> Decimal:
    return _EXACT.divide(Decimal(room), -_EXACT.ln(_EXACT.divide(Decimal(2 * draw + 1), _DRAWS)))


@dataclass(frozen=True, slots=True)
class Placement:
    """The custodians (33-byte keys) with their declared room, in any unit, and how many keep a clip (0: the default)."""

    rooms: Mapping[bytes, int]
    copies: int = 0

    @classmethod
    def of(cls, declared: Mapping[bytes, int], copies: int) -> Placement:
        """Who declares no room (0) counts as the least of those who do."""
        least = min((room for room in declared.values() if room), default=1)
        return cls({key: room or least for key, room in declared.items()}, copies)

    @classmethod
    def even(cls, custodians: Iterable[bytes], copies: int) -> Placement:
        return cls(dict.fromkeys(custodians, 1), copies)

    @property
    def count(self) -> int:
        """How many custodians keep each clip."""
        return min(self.copies or COPIES_DEFAULT_COUNT, len(self.rooms))

    def rank(self, record_id: bytes) -> tuple[bytes, ...]:
        """All custodians, the record's keepers first."""
        draws = {key: _draw(record_id, key) for key in self.rooms}
        scores: Mapping[bytes, int | Decimal] = draws
        if len(set(self.rooms.values())) > 1:  # of equal rooms the draws have the same order, 50 times faster
            scores = {key: _score(draws[key], room) for key, room in self.rooms.items()}
        return tuple(sorted(draws, key=lambda key: (-scores[key], -draws[key], key)))

    def keepers(self, record_id: bytes) -> tuple[bytes, ...]:
        return self.rank(record_id)[: self.count]

    def is_keeper(self, custodian: bytes, record_id: bytes) -> bool:
        if self.count == len(self.rooms):
            return custodian in self.rooms
        return custodian in self.keepers(record_id)
