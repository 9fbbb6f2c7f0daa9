"""Features that link one person's visits: keys, time, robot, size, all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from network.lab.privacy.attacks.ledger_view import VisitSeen
from network.lab.privacy.attacks.trials import Features

_MINUTES_5_MS, _CLIP_MS = 300_000, 500


def by_key(visits: Sequence[VisitSeen], extra_marks: Sequence[bytes] = ()) -> Features:
    """Compare all naming and sealing fields: equality, common bits and prefixes."""

    def features(first: int, second: int) -> list[float]:
        one, two = visits[first], visits[second]
        pairs = [(one.owner, two.owner), (one.ephemeral, two.ephemeral)]
        if one.records and two.records:
            a, b = one.records[0], two.records[0]
            pairs += [
                (a.record_id, b.record_id),
                (a.commitment_root, b.commitment_root),
                (a.ciphertext_root, b.ciphertext_root),
                (a.sealed_metadata[:32], b.sealed_metadata[:32]),
                (a.sealed_metadata, b.sealed_metadata),
            ]
        else:
            pairs += [(b"", b"")] * 5
        if extra_marks:
            pairs.append((extra_marks[first], extra_marks[second]))
        found = [float(one.view_tag == two.view_tag), abs(one.view_tag - two.view_tag)]
        for left, right in pairs:
            found += [_bits_apart(left, right), _common_beginning(left, right), float(left == right)]
        return found

    return features


def by_time(visits: Sequence[VisitSeen]) -> Features:
    """Compare block times (ms), submission order, record rhythm and closing."""
    shapes = [_time_shape(visit) for visit in visits]
    ranks = _ranks(visits)

    def features(first: int, second: int) -> list[float]:
        apart = np.abs(shapes[first] - shapes[second])
        day_apart = abs(visits[first].at_ms - visits[second].at_ms) % 86_400_000
        clock = min(day_apart, 86_400_000 - day_apart)
        return [*apart.tolist(), abs(ranks[first] - ranks[second]), ranks[second], float(clock), *shapes[second]]

    return features


def by_robot(visits: Sequence[VisitSeen]) -> Features:
    def features(first: int, second: int) -> list[float]:
        one, two = visits[first], visits[second]
        return [float(one.robot == two.robot), _bits_apart(one.robot, two.robot)]

    return features


def by_company(visits: Sequence[VisitSeen]) -> Features:
    shapes = []
    for visit in visits:
        apart = [
            abs(other.at_ms - visit.at_ms) for other in visits if other.robot == visit.robot and other is not visit
        ]
        shapes.append((np.log1p(min(apart, default=_MINUTES_5_MS)), float(sum(gap < _CLIP_MS for gap in apart))))

    def features(first: int, second: int) -> list[float]:
        (gap, beside), (other_gap, other_beside) = shapes[first], shapes[second]
        return [abs(gap - other_gap), abs(beside - other_beside), other_gap, other_beside, gap]

    return features


def by_length(visits: Sequence[VisitSeen]) -> Features:
    def features(first: int, second: int) -> list[float]:
        one, two = visits[first], visits[second]
        counts = abs(np.log1p(len(one.records)) - np.log1p(len(two.records)))
        spans = abs(np.log1p(one.ends_ms - one.at_ms) - np.log1p(two.ends_ms - two.at_ms))
        return [float(counts), float(spans), float(len(two.records))]

    return features


def by_size(sizes: Sequence[Sequence[int]]) -> Features:
    shapes = [_size_shape(found) for found in sizes]

    def features(first: int, second: int) -> list[float]:
        return [*np.abs(shapes[first] - shapes[second]).tolist(), *shapes[second].tolist()]

    return features


def _size_shape(sizes: Sequence[int]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    logs = np.log(np.asarray(sizes, dtype=np.float64)) if sizes else np.zeros(1)
    return np.array([logs.mean(), logs.min(), logs.max(), np.median(logs), logs.std()])


def _time_shape(visit: VisitSeen) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    times = np.array([visit.at_ms, *(record.at_ms for record in visit.records)], dtype=np.float64)
    gaps = np.minimum(np.diff(times), 10 * _CLIP_MS) if len(times) > 1 else np.zeros(1)
    places = [record.position for record in visit.records] or [0]
    return np.array(
        [
            gaps[0],
            gaps.mean(),
            gaps.std(),
            gaps.min(),
            visit.at_ms % 1000,
            visit.at_ms % _CLIP_MS,
            visit.at_ms % _MINUTES_5_MS,
            float(visit.position),
            float(np.mean(places)),
            float(max(0, visit.closed_at_ms - visit.at_ms)),
        ]
    )


def _ranks(visits: Sequence[VisitSeen]) -> list[float]:
    ranks = []
    for visit in visits:
        since = visit.at_ms - 3 * _MINUTES_5_MS
        ranks.append(float(sum(other.robot == visit.robot and since < other.at_ms < visit.at_ms for other in visits)))
    return ranks


def _bits_apart(first: bytes, second: bytes) -> float:
    count = min(len(first), len(second))
    apart = int.from_bytes(first[:count], "big") ^ int.from_bytes(second[:count], "big")
    return float(apart.bit_count())


def _common_beginning(first: bytes, second: bytes) -> float:
    count = 0
    for left, right in zip(first, second, strict=False):
        if left != right:
            break
        count += 1
    return float(count)
