"""Post-stage: wallets' results checked by ground truth: own data only, others hidden, corruption detected."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path

from clients.robot.synthetic.scenario_bag import Scene, scenario_of
from clients.sdk.pictures.picture_names import read_robot_frame
from clients.wallet.answers.record_answers import (
    AuditAnswer,
    ProbeAnswer,
    RecordRow,
    RecordsAnswer,
    VerifyAnswer,
    ViewAnswer,
)
from network.demo.checks import CheckList
from network.demo.scene_truth import FOREIGN_PIXELS_MAX_SHARE, covered_frames, worst_foreign_share
from network.demo.tampering import flip_stored_byte
from network.demo.words import name_person
from network.testbed import Stage

REFUSALS = frozenset({"NOT_PERMITTED", "ACCESS_NOT_GRANTED"})


@dataclass(slots=True)
class WalletContents:
    """What a person's wallet found: records as listed, and pictures written."""

    records: list[RecordRow] = field(default_factory=list)
    pictures: list[Path] = field(default_factory=list)
    depths: list[Path] = field(default_factory=list)

    @property
    def record_ids(self) -> list[str]:
        return [row.record_id for row in self.records]


class PostStage:
    """Checks every wallet's access, also to others' records."""

    def __init__(
        self, stage: Stage, scene: Scene, pictures: Path, checks: CheckList, on_progress: Callable[[str], None]
    ) -> None:
        self._stage = stage
        self._scene = scene
        self._scenario = scenario_of(scene)
        self._pictures = pictures
        self._checks = checks
        self._on_progress = on_progress

    async def look(self, people: Sequence[str], kept: int) -> dict[str, WalletContents]:
        found = {alias: await self._open(alias) for alias in people}
        total = sum(len(belongings.depths) for belongings in found.values())
        self._checks.add(
            "the wallets together open every picture that the robot kept",
            ok=total == kept,
            detail=f"{total} opened, {kept} kept",
        )
        for owner, stranger in permutations(people, 2):
            if found[owner].records:
                await self._check_stranger(owner, stranger, found)
        return found

    async def _open(self, alias: str) -> WalletContents:
        self._on_progress(f"post-stage: {name_person(alias)} looks at their records")
        listed = await self._stage.wallet(alias, RecordsAnswer, "records")
        records = [row for visit in listed.visits for row in visit.records]
        if not self._is_in_scene(alias):
            self._checks.add(
                f"{name_person(alias)}, whom the robot never met, has nothing",
                ok=not listed.visits,
                detail=f"{len(records)} records",
            )
            return WalletContents()
        missing = sum(visit.missing_records for visit in listed.visits)
        closed = all(visit.closed for visit in listed.visits)
        self._checks.add(
            f"{name_person(alias)} finds all their records",
            ok=bool(records) and missing == 0 and closed,
            detail=f"{len(records)} records, {missing} missing",
        )
        out = self._pictures / alias
        seen = await self._stage.wallet(alias, ViewAnswer, "view", "--out", str(out))
        statuses = [frame.status for record in seen.records for frame in record.frames]
        self._checks.add(
            f"{name_person(alias)} opens and verifies them",
            ok="ok" in statuses and set(statuses) <= {"ok", "notice"},
            detail=f"{statuses.count('ok')} pictures, against a header proven final from the genesis file",
        )
        found = WalletContents(records, sorted(out.glob("*/*[0-9].png")), sorted(out.glob("*/*.depth.png")))
        await self._check_own(alias, found)
        return found

    def _is_in_scene(self, alias: str) -> bool:
        return alias in self._scenario.tagged_aliases

    async def _check_own(self, alias: str, found: WalletContents) -> None:
        person = next(person for person in self._scenario.people if person.alias == alias)
        covered = covered_frames(self._scenario, alias)
        sequences = {read_robot_frame(path.name) for path in found.depths}
        absent = [number for number in sequences if person.place(number / self._scenario.frame_rate) is None]
        self._checks.add(
            f"{name_person(alias)} has their own data only",
            ok=sequences <= covered and not absent,
            detail=f"{len(sequences - covered)} of {len(sequences)} pictures outside their tag's time, "
            f"{len(absent)} of moments when they were not there",
        )
        worst, judged = await asyncio.to_thread(worst_foreign_share, self._scene, found.depths, alias)
        self._checks.add(
            f"{name_person(alias)}'s pictures show nobody else",
            ok=worst <= FOREIGN_PIXELS_MAX_SHARE and (judged > 0 or not self._met_others(alias, sequences)),
            detail=f"{judged} judged with others in view; at most {100 * worst:.3f} % of their pixels in any",
        )

    def _met_others(self, alias: str, sequences: set[int]) -> bool:
        others = [person for person in self._scenario.people if person.alias != alias]
        rate = self._scenario.frame_rate
        return any(other.place(number / rate) is not None for number in sequences for other in others)

    async def _check_stranger(self, owner: str, stranger: str, found: dict[str, WalletContents]) -> None:
        first = found[owner].record_ids[0]
        out = self._pictures / "none"
        refused = await self._stage.refusal(stranger, "view", first, "--out", str(out))
        probe = await self._stage.wallet(stranger, ProbeAnswer, "probe", first)
        codes = set(probe.refusals.values())
        shared = set(found[owner].record_ids) & set(found[stranger].record_ids)
        self._checks.add(
            f"{name_person(stranger)} gets no frame of {name_person(owner)}",
            ok=not shared and refused == "RECORD_NOT_FOUND" and bool(codes) and codes <= REFUSALS,
            detail=f"their wallet says {refused or 'nothing'}; custodians say {', '.join(sorted(codes))}",
        )

    async def corrupt_and_verify(self, found: dict[str, WalletContents]) -> None:
        alias = next(alias for alias, belongings in found.items() if belongings.records)
        record = max(found[alias].records, key=lambda row: row.frames)
        record_id, index = record.record_id, record.frames // 2
        self._on_progress("post-stage: changing a stored byte")
        cluster = self._stage.cluster
        for node in cluster.genesis.custodians:
            await asyncio.to_thread(flip_stored_byte, cluster.config(node.name), bytes.fromhex(record_id), index)
        verdicts = await self._verify(alias)
        bad = [place for place, status in verdicts.items() if status == "corrupted"]
        self._checks.add(
            "corruption off-chain is detected, and the frame named",
            ok=bad == [(record_id, index)],
            detail=f"picture {index + 1} of record {record_id[:8]} was changed; corrupted by the wallet's verdict: "
            + (", ".join(f"{name[:8]}/{place + 1}" for name, place in bad) or "none"),
        )
        rest = {status for place, status in verdicts.items() if place != (record_id, index)}
        self._checks.add(
            "all other frames still open",
            ok=rest <= {"ok", "notice"},
            detail=f"{len(verdicts) - 1} frames: {', '.join(sorted(rest))}",
        )
        trail = await self._stage.wallet(alias, AuditAnswer, "audit")
        found_verdicts = [row for row in trail.entries if row.kind == "verdict" and record_id in row.records]
        self._checks.add(
            "the verdict is on the chain",
            ok=len(found_verdicts) == 1,
            detail=f"{len(found_verdicts)} about this record",
        )

    async def verify_untouched(self, found: dict[str, WalletContents]) -> None:
        verdicts: dict[tuple[str, int], str] = {}
        for alias, belongings in found.items():
            if belongings.records:
                ids = belongings.record_ids
                verdicts |= await self._verify(alias, *dict.fromkeys((ids[0], ids[len(ids) // 2], ids[-1])))
        statuses = sorted(set(verdicts.values()))
        self._checks.add(
            "nothing untouched is called corrupted",
            ok=bool(verdicts) and set(statuses) <= {"ok", "notice"},
            detail=f"{len(verdicts)} frames: {', '.join(statuses)}",
        )

    async def _verify(self, alias: str, *record_ids: str) -> dict[tuple[str, int], str]:
        self._on_progress(f"post-stage: {name_person(alias)} verifies their records")
        answer = await self._stage.wallet(alias, VerifyAnswer, "verify", *record_ids)
        return {
            (record.record_id, frame.number - 1): frame.status for record in answer.records for frame in record.frames
        }
