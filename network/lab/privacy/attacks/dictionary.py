"""Dictionary search over every possible UID against each scheme's public data."""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

from consensus.primitives.hashing import tagged_hasher
from network.lab.privacy.hospital.population import UID_PREFIX
from network.lab.privacy.hospital.schemes import OwnerMark

COMPUTED_BITS = (32, 40, 56, 96)
GPU_HASHES_A_SECOND = 10**10
"""One graphics card of the present, by published benchmarks of SHA-256: not measured here."""

_CHUNK_COUNT = 1 << 16
_WEAK_NAMES = ("blockrobot/handle", "blockrobot/tag", "blockrobot/owner", "blockrobot/visit")


@dataclass(frozen=True, slots=True)
class Search:
    """UIDs found by target index, hashes made, and CPU seconds."""

    found: dict[int, str]
    hashes: int
    seconds: float

    @property
    def rate(self) -> float:
        return self.hashes / self.seconds if self.seconds else 0.0


def enumerate_uids(serial_bits: int, part: int = 0, parts: int = 1) -> Iterator[list[bytes]]:
    """Yield all, or the first of so many parts (0) or another."""
    for start in range(part * _CHUNK_COUNT, 1 << serial_bits, parts * _CHUNK_COUNT):
        stop = min(start + _CHUNK_COUNT, 1 << serial_bits)
        yield [b"%s%010X" % (UID_PREFIX.encode(), serial) for serial in range(start, stop)]


def search_marks(marks: Sequence[OwnerMark], pepper: bytes, serial_bits: int) -> Search:
    targets: dict[bytes, dict[bytes, list[int]]] = {}
    for place, mark in enumerate(marks):
        targets.setdefault(mark.salt, {}).setdefault(mark.digest, []).append(place)
    found: dict[int, str] = {}
    hashes, started = 0, time.process_time()
    sha256 = hashlib.sha256
    for salt, wanted in targets.items():
        left, before = len(wanted), pepper + salt
        for uids in enumerate_uids(serial_bits):
            hits = [uid for uid in uids if sha256(before + uid).digest() in wanted]
            hashes += len(uids)
            for uid in hits:
                found.update(dict.fromkeys(wanted[sha256(before + uid).digest()], uid.decode()))
            left -= len(hits)
            if left <= 0:
                break
    return Search(found, hashes, time.process_time() - started)


def weak_functions(chain_id: bytes) -> list[Callable[[bytes], bytes]]:
    functions: list[Callable[[bytes], bytes]] = [
        lambda uid: hashlib.sha256(uid).digest(),
        lambda uid: hashlib.sha256(chain_id + uid).digest(),
        lambda uid: hmac.digest(chain_id, uid, "sha256"),
        lambda uid: hashlib.sha256(bytes.fromhex(uid.decode())).digest(),
        bytes,
        lambda uid: bytes.fromhex(uid.decode()),
    ]
    return functions + [tagged_hasher(name) for name in _WEAK_NAMES]


def search_chain(marks: Collection[bytes], chain_id: bytes, serial_bits: int, part: int = 0, parts: int = 1) -> Search:
    wanted = set(marks) | {mark[1:] for mark in marks if len(mark) == 33}
    found: dict[int, str] = {}
    hashes, started = 0, time.process_time()
    for uids in enumerate_uids(serial_bits, part, parts):
        for function in weak_functions(chain_id):
            hashes += len(uids)
            for uid in uids:
                image = function(uid)
                if image in wanted or image[:16] in wanted:
                    found[len(found)] = uid.decode()
    return Search(found, hashes, time.process_time() - started)


def computed_costs(hashes_a_second: float) -> dict[str, float]:
    """Core hours per number of unknown bits, and those of a graphics card."""
    figures: dict[str, float] = {}
    for bits in COMPUTED_BITS:
        hours = 2.0**bits / max(hashes_a_second, 1.0) / 3600
        figures[f"computed_dictionary_{bits}_bit_core_hours"] = float(f"{hours:.3g}")
        figures[f"computed_dictionary_{bits}_bit_gpu_hours"] = float(f"{2.0**bits / GPU_HASHES_A_SECOND / 3600:.3g}")
    return figures
