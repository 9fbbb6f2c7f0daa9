"""Which custodians keep a clip: rendezvous hashing over the members, weighted by their declared room.

Schindler's method: the custodians with the highest w / -ln(u), with u in (0, 1) from a hash of record and custodian; each
organisation's first one before any second one. Scores that floats cannot tell apart for certain are compared by `decimal`,
whose logarithm is rounded correctly, so every machine finds the same order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from decimal import ROUND_HALF_EVEN, Context, Decimal
from itertools import pairwise

from consensus.primitives.hashing import tagged_hash

COPIES_DEFAULT_COUNT = 3
"""Of a clip, while the organisations decided nothing else; with fewer custodians each keeps all."""

_TAG = "blockrobot/placement"
_DRAW_BYTES = 8
_DRAWS = 1 << (8 * _DRAW_BYTES + 1)
_SURELY = 1 + 1e-9  # so much better is better for certain: floats are wrong by less than 1e-12
_EXACT = Context(prec=50, rounding=ROUND_HALF_EVEN)


@dataclass(frozen=True, slots=True)
class Placement:
    """The custodians (33-byte keys) with their declared room, in any unit, and how many keep a clip (0: the default).

    `organisations`: whose each is; without one, its own.
    """

    rooms: Mapping[bytes, int]
    copies: int = 0
    organisations: Mapping[bytes, str] = field(default_factory=dict)

    @classmethod
    def of(cls, declared: Mapping[bytes, int], copies: int, organisations: Mapping[bytes, str]) -> Placement:
        """Who declares no room (0) counts as the least of those who do."""
        least = min((room for room in declared.values() if room), default=1)
        return cls({key: room or least for key, room in declared.items()}, copies, organisations)

    @classmethod
    def even(cls, custodians: Iterable[bytes], copies: int) -> Placement:
        return cls(dict.fromkeys(custodians, 1), copies)

    @property
    def count(self) -> int:
        """How many custodians keep each clip."""
        return min(self.copies or COPIES_DEFAULT_COUNT, len(self.rooms))

    def rank(self, record_id: bytes) -> tuple[bytes, ...]:
        """All custodians, the record's keepers first."""
        firsts: dict[str | bytes, bytes] = {}
        ranked = self._rank_by_score(record_id)
        for key in ranked:
            firsts.setdefault(self.organisations.get(key, key), key)
        chosen = set(firsts.values())
        return (*firsts.values(), *(key for key in ranked if key not in chosen))

    def keepers(self, record_id: bytes) -> tuple[bytes, ...]:
        return self.rank(record_id)[: self.count]

    def is_keeper(self, custodian: bytes, record_id: bytes) -> bool:
        if self.count == len(self.rooms):
            return custodian in self.rooms
        return custodian in self.keepers(record_id)

    def _rank_by_score(self, record_id: bytes) -> list[bytes]:
        draws = {key: _draw(record_id, key) for key in self.rooms}
        if len(set(self.rooms.values())) == 1:  # the draws have the same order
            return sorted(draws, key=lambda key: (-draws[key], key))
        scores = {key: room / _minus_log(draws[key]) for key, room in self.rooms.items()}
        ranked = sorted(draws, key=lambda key: -scores[key])
        if all(scores[one] > scores[other] * _SURELY for one, other in pairwise(ranked)):
            return ranked
        exact = {key: _exact_score(draws[key], room) for key, room in self.rooms.items()}
        return sorted(draws, key=lambda key: (-exact[key], -draws[key], key))


def _draw(record_id: bytes, custodian: bytes) -> int:
    return int.from_bytes(tagged_hash(_TAG, record_id, custodian)[:_DRAW_BYTES], "big")


def _minus_log(draw: int) -> float:
    """Return -ln(u) to 12 digits, also near 1."""
    odd = 2 * draw + 1
    return -math.log(odd / _DRAWS) if odd < _DRAWS // 2 else -math.log1p((odd - _DRAWS) / _DRAWS)


def _exact_score(draw: int, room: int) -> Decimal:
    return _EXACT.divide(Decimal(room), -_EXACT.ln(_EXACT.divide(Decimal(2 * draw + 1), Decimal(_DRAWS))))
