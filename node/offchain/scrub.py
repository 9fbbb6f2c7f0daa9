"""The scrub: compares the chain's records with the store's clips, both ways. Must never repair what it cannot prove.

A clip that is missing is put among the missing ones, so that it is fetched; all else is reported, for a person to judge.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Protocol

from consensus.primitives.hashing import sha256
from consensus.records.commitments import ciphertext_leaf
from node.offchain.block_effects import matches_roots
from node.offchain.custodian import Custodian
from node.offchain.store import BlockEffects, ClipRow, CustodyStore, RecordFacts


@dataclass(frozen=True, slots=True)
class ChainRecord:
    """A record of the finalized state; `kept` is False once it is erased or expired there, and its roots are gone."""

    facts: RecordFacts
    kept: bool


class ChainRecords(Protocol):
    """The finalized state's records, as far as a custodian looks at them."""

    def records(self) -> AsyncIterator[ChainRecord]:
        """Yield every record of the newest finalized state."""
        ...


@dataclass(slots=True)
class ScrubReport:
    """What a scrub found, by record id; `corrupted` are frames whose stored bytes no longer make their leaf."""

    compared_count: int = 0
    missing: list[bytes] = field(default_factory=list)
    held_though_erased: list[bytes] = field(default_factory=list)
    unknown_to_chain: list[bytes] = field(default_factory=list)
    other_roots: list[bytes] = field(default_factory=list)
    corrupted: list[tuple[bytes, int]] = field(default_factory=list)

    @property
    def is_clean(self) -> bool:
        """Tell whether chain and store agree."""
        found = (self.missing, self.held_though_erased, self.unknown_to_chain, self.other_roots, self.corrupted)
        return not any(found)


async def scrub(custodian: Custodian, store: CustodyStore, chain: ChainRecords) -> ScrubReport:
    """Compare chain and store up to the store's checkpoint, and list clips that the store should have as missing."""
    report = ScrubReport()
    point = await store.checkpoint()
    followed = point.height if point is not None else 0
    on_chain = {record.facts.record_id: record async for record in chain.records() if record.facts.height <= followed}
    known_missing = {facts.record_id for facts in await store.missing(max(1, len(on_chain)))}
    held: set[bytes] = set()
    async for clip in store.all_clips():
        held.add(clip.record_id)
        if clip.status == "confirmed" and clip.height <= followed:
            report.compared_count += 1
            await _compare(custodian, clip, on_chain.get(clip.record_id), report)
    absent = [record.facts for key, record in on_chain.items() if record.kept and key not in held]
    report.missing = sorted(facts.record_id for facts in absent)
    await store.apply(BlockEffects(missing=tuple(facts for facts in absent if facts.record_id not in known_missing)))
    return report


async def _compare(custodian: Custodian, clip: ClipRow, record: ChainRecord | None, report: ScrubReport) -> None:
    if record is None:
        report.unknown_to_chain.append(clip.record_id)
        return
    if not record.kept:
        report.held_though_erased.append(clip.record_id)
        return
    if record.facts.owner != clip.owner or not matches_roots(clip, record.facts):
        report.other_roots.append(clip.record_id)
        return
    download = await custodian.export(clip.record_id)
    for frame, leaf in zip(download.frames, clip.ciphertext_leaves, strict=True):
        expected_erased = frame.index in record.facts.erased_frames
        made = ciphertext_leaf(frame.index, sha256(frame.ciphertext), sha256(frame.sealed_key))
        if not frame.erased and (made != leaf or expected_erased):
            report.corrupted.append((clip.record_id, frame.index))
