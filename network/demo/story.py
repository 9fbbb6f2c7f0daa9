"""The demonstration's steps; robot, wallets and registrar run as separate processes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clients.bundle.bundle_answers import VerifyBundleAnswer
from clients.robot.run.run_summary import RunSummary
from clients.robot.synthetic.driving.drive_file import DRIVE_TOPICS_FILE, load_shipped_scene
from clients.robot.synthetic.scenario import Scenario, published_run_1
from clients.robot.synthetic.scenario_bag import Scene, load_or_draw_tags, make_bag
from clients.sdk.pictures.picture_names import read_robot_frame
from clients.wallet.answers.record_answers import (
    AuditAnswer,
    AuditEvent,
    ErasuresAnswer,
    ExportAnswer,
    ProbeAnswer,
    RecordRow,
    RecordsAnswer,
    VerifyAnswer,
    ViewAnswer,
)
from clients.wallet.answers.sharing_answers import EraseAnswer
from consensus.errors import BlockRobotError
from network.cluster import read_metric
from network.custody.hunt import gather, hunt
from network.custody.traces import Trace
from network.demo.checks import CheckList
from network.demo.leader_kill import LeaderKill, kill_and_restart_leader
from network.demo.processes import LongCommand, Progress, run_command
from network.demo.scene_truth import FOREIGN_PIXELS_MAX_SHARE, covered_frames, worst_foreign_share
from network.demo.tampering import flip_stored_byte
from network.demo.words import events_text, name_person, reasons_text, refusal_text
from network.testbed import Stage

RECORDING_TIMEOUT_S = 150.0
WITHHELD_MAX_SHARE = 0.30
EXPORTED_COUNT = 3
_TRANSACTIONS_METRIC = "blockrobot_transactions_finalized_total"
PURPOSE = "demo"
PATIENTS = ("patient-a", "patient-b")
DRIVEN = "patient-b"
DRIVES_FROM_FRAME = 70  # a second after demo-drive.toml lets the robot start: the empty scene fits no more


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """Output folder, recording cache, custodians' store, and first port."""

    out: Path
    cache: Path
    store: str
    base_port: int
    keep: bool


@dataclass(slots=True)
class DemoState:
    """State shared by the steps."""

    robot_member: str = ""
    summary: RunSummary | None = None
    kill: LeaderKill | None = None
    records: dict[str, list[RecordRow]] = field(default_factory=dict)
    pictures: dict[str, list[Path]] = field(default_factory=dict)
    on_the_way: list[Path] = field(default_factory=list)
    audit: list[AuditEvent] = field(default_factory=list)
    blocks: int = 0
    transactions: int = 0


class Demo:
    """One run. `on_progress` receives progress lines; checks go to `checks`."""

    def __init__(self, options: DemoOptions, checks: CheckList, on_progress: Callable[[str], None]) -> None:
        self.options = options
        self.checks = checks
        self.state = DemoState()
        self.scenario: Scenario = published_run_1()
        self.drive: Scene = load_shipped_scene("demo-drive")
        self._on_progress = on_progress
        self._notice_version = 0
        self._is_over = False
        self.stage = Stage(options.out, store=options.store, base_port=options.base_port, purpose=PURPOSE)

    async def run(self) -> None:
        """An exception becomes a failed check and ends the run."""
        self._tags = load_or_draw_tags(self.options.cache, self.scenario)
        rendering = asyncio.create_task(self._render())  # beside the network's start, which waits for much
        try:
            await self._run_steps(rendering)
        finally:
            self._is_over = True
            rendering.cancel()
            await asyncio.gather(rendering, return_exceptions=True)

    async def _run_steps(self, rendering: asyncio.Task[Path]) -> None:
        steps: list[tuple[str, Callable[[], Any]]] = [
            ("the network starts", self.start_network),
            ("people and robot are enrolled", self.enrol),
            ("the robot records", lambda: self.record(rendering)),
            ("patients look at their records", self.look),
            ("a stored byte is changed", self.tamper),
            ("patient A erases", self.erase),
            ("the trail is read", self.read_trail),
            ("patient B takes data along, and the robot drives", self.drive_and_take_along),
        ]
        for name, step in steps:
            self._on_progress(name)
            try:
                await step()
            except BlockRobotError as error:
                self.checks.add(name, ok=False, detail=f"{error.code}: {error.detail} {error.next_step}")
                return

    async def _render(self) -> Path:
        started = time.monotonic()
        shown = -1

        def progress(done: int, total: int) -> None:
            nonlocal shown
            if self._is_over:  # the thread would render on for a minute
                raise BlockRobotError("INTERNAL", "Rendering was ended.")
            if done * 10 // total > shown:
                shown = done * 10 // total
                self._on_progress(f"rendering the recording: {done} of {total} frames")

        bag = await asyncio.to_thread(make_bag, self.scenario, self._tags, self.options.cache, progress=progress)
        self._on_progress(f"the recording is there ({time.monotonic() - started:.0f} s)")
        return bag

    async def drive_and_take_along(self) -> None:
        """The one is done by the robot, the other by a wallet and a stranger."""
        await asyncio.gather(self.drive_along(), self.take_along())

    async def drive_along(self) -> None:
        bag = await asyncio.to_thread(make_bag, self.drive, self._tags, self.options.cache)
        arguments = [*self.stage.robot_arguments(), "replay", str(bag), "--purpose", PURPOSE]
        arguments += ["--topics", str(DRIVE_TOPICS_FILE), "--approve-as", self.stage.organisation]
        arguments += ["--events", str(self.options.out / "drive-events.jsonl")]
        summary = await LongCommand(arguments, RunSummary, lambda _: None).run(RECORDING_TIMEOUT_S)
        driving, known = summary.driving, {row.record_id for row in self.state.records[DRIVEN]}
        listed = await self.stage.wallet(DRIVEN, RecordsAnswer, "records")
        new = [row.record_id for visit in listed.visits for row in visit.records if row.record_id not in known]
        out = self.options.out / "pictures" / "on-the-way"
        viewed = await self.stage.wallet(DRIVEN, ViewAnswer, "view", *new, "--out", str(out), "--purpose", "own-access")
        self.state.on_the_way, depths = (
            [path for path in sorted(out.glob(kind)) if read_robot_frame(path.name) >= DRIVES_FROM_FRAME]
            for kind in ("*/*[0-9].png", "*/*.depth.png")
        )
        worst, judged = await asyncio.to_thread(worst_foreign_share, self.drive, depths, DRIVEN)
        without_room = "ROOM_NOT_RECORDED" in {room.code for room in viewed.missing_rooms}
        self.checks.add(
            "while the robot drives, a person whom it knows is recorded, alone and without the room",
            ok=driving is not None
            and driving.kept >= len(depths) > 0
            and without_room
            and judged > 0
            and worst <= FOREIGN_PIXELS_MAX_SHARE,
            detail=f"{driving.kept if driving else 0} of {driving.frames if driving else 0} frames of ten seconds; "
            f"{judged} judged with others in view: at most {100 * worst:.3f} % of their pixels in any",
        )

    async def start_network(self) -> None:
        started = time.monotonic()
        peers = await self.stage.start_network("demo")
        self._notice_version = await self.stage.publish_notice()
        self.checks.add(
            "4 nodes of 2 organisations are ready",
            ok=len(peers) == 4 and min(peers) == 3,
            detail=f"each in touch with {min(peers, default=0)} peers over mutual TLS, "
            f"after {time.monotonic() - started:.1f} s",
        )

    def _check_told(self) -> None:
        notice, signed = self._notice_version, [self.stage.receipts.get(patient) for patient in PATIENTS]
        told = [each for each in signed if each is not None and each.notice_version == notice]
        self.checks.add(
            "patients were told before they consented, and hold receipts",
            ok=notice == 1 and len(told) == len(PATIENTS),
            detail=f"{len(told)} receipts under version {notice} of the hospital's notice, signed by both sides",
        )

    async def enrol(self) -> None:
        held = [await self.stage.enrol_person(patient, self._tags[patient]) for patient in PATIENTS]
        self.checks.add(
            "two patients are registered",
            ok=all(held),
            detail="the key that the contract recovered from each signature is the wallet's own",
        )
        self._check_told()
        self.state.robot_member = await self.stage.enrol_robot()
        rows = await self.stage.make_roster(self.state.robot_member)
        self.checks.add(
            "the robot has its sealed roster",
            ok=rows == len(PATIENTS),
            detail=f"{rows} people; only this robot can open it",
        )

    async def record(self, rendering: asyncio.Task[Path]) -> None:
        bag = await rendering
        expected_kept = self._expected_covered() // 2
        kill: asyncio.Task[LeaderKill] | None = None

        def progress(figures: Progress) -> None:
            nonlocal kill
            self._on_progress(
                f"recording: {figures.frames_read} frames seen, {figures.frames_recorded} recorded (counted for each "
                f"owner), {figures.waiting} clips on their way"
            )
            if kill is None and figures.frames_recorded >= expected_kept:
                self._on_progress("killing the leading node")
                kill = asyncio.create_task(kill_and_restart_leader(self.stage.cluster))

        arguments = [*self.stage.robot_arguments(), "replay", str(bag), "--purpose", PURPOSE]
        arguments += ["--approve-as", self.stage.organisation]
        arguments += ["--events", str(self.options.out / "events.jsonl")]
        self.state.summary = await LongCommand(arguments, RunSummary, progress).run(RECORDING_TIMEOUT_S)
        self._check_frames(self.state.summary)
        if kill is None:
            self.checks.add("the leading node is killed and comes back", ok=False, detail="half was never recorded")
            return
        self.state.kill = await kill
        self.checks.add(
            "the leading node is killed and comes back",
            ok=self.state.kill.caught_up,
            detail=f"{self.state.kill.name} got SIGKILL; nothing became final for {self.state.kill.gap_s:.2f} s; "
            f"after its restart it had caught up in {self.state.kill.catch_up_s:.1f} s",
        )

    def _expected_covered(self) -> int:
        return sum(len(covered_frames(self.scenario, alias)) for alias in self.scenario.tagged_aliases)

    def _check_frames(self, summary: RunSummary) -> None:
        frames, rows = summary.frames, summary.roster_rows
        self.checks.add(
            "the robot proves its roster against the chain",
            ok=rows == len(PATIENTS),
            detail=f"{rows} people, each row equal to what a finalized header proves",
        )
        self.checks.add(
            "every frame of the camera arrived",
            ok=frames.published == self.scenario.frame_count,
            detail=f"{frames.published} of {self.scenario.frame_count}",
        )
        expected = self._expected_covered()
        self.checks.add(
            "the right frames were paired",
            ok=frames.covered == expected,
            detail=f"{frames.covered} frames and owners, {expected} by the scenario's own readings",
        )
        self.checks.add(
            "no frame that should be kept is lost",
            ok=frames.lost == 0 and frames.covered == frames.kept + frames.withheld,
            detail=f"covered {frames.covered} = kept {frames.kept} + withheld {frames.withheld}",
        )
        share = frames.withheld / max(1, frames.covered)
        self.checks.add(
            "at most 30 % were withheld, each with its reason",
            ok=share <= WITHHELD_MAX_SHARE and sum(frames.withheld_reasons.values()) == frames.withheld,
            detail=f"{100 * share:.1f} %: {reasons_text(frames.withheld_reasons)}",
        )

    async def look(self) -> None:
        looks = await asyncio.gather(*(self._list_and_view(patient) for patient in PATIENTS))
        for patient, (listed, seen) in zip(PATIENTS, looks, strict=True):
            self.state.records[patient] = [row for visit in listed.visits for row in visit.records]
            missing = sum(visit.missing_records for visit in listed.visits)
            closed = all(visit.closed for visit in listed.visits)
            frames = sum(row.frames for row in self.state.records[patient])
            self.checks.add(
                f"{name_person(patient)} finds all their records",
                ok=bool(self.state.records[patient]) and missing == 0 and closed,
                detail=f"{len(self.state.records[patient])} records, {frames} pictures, none missing",
            )
            out = self._pictures_of(patient)
            statuses = [frame.status for record in seen.records for frame in record.frames]
            self.state.pictures[patient] = sorted(out.glob("*/*[0-9].png"))
            self.checks.add(
                f"{name_person(patient)} opens and verifies them",
                ok="ok" in statuses and set(statuses) <= {"ok", "notice"},
                detail=f"{statuses.count('ok')} pictures, against a header proven final from the genesis file",
            )
            own = sorted(out.glob("*/*.depth.png"))
            worst, judged = await asyncio.to_thread(worst_foreign_share, self.scenario, own, patient)
            self.checks.add(
                f"{name_person(patient)}'s pictures show nobody else",
                ok=judged > 0 and worst <= FOREIGN_PIXELS_MAX_SHARE,
                detail=f"{judged} pictures taken while others stood in view; "
                f"at most {100 * worst:.3f} % of their pixels in any",
            )
        await self._check_strangers()

    async def _list_and_view(self, patient: str) -> tuple[RecordsAnswer, ViewAnswer]:
        listed = await self.stage.wallet(patient, RecordsAnswer, "records")
        out = str(self._pictures_of(patient))
        return listed, await self.stage.wallet(patient, ViewAnswer, "view", "--out", out, "--purpose", "own-access")

    def _pictures_of(self, patient: str) -> Path:
        return self.options.out / "pictures" / patient

    async def _check_strangers(self) -> None:
        own = {row.record_id for row in self.state.records["patient-b"]}
        foreign = [row.record_id for row in self.state.records["patient-a"]]
        refused = await self.stage.refusal("patient-b", "view", foreign[0], "--out", str(self.options.out / "none"))
        self.checks.add(
            "patient B's wallet cannot tell which records are A's, nor fetch them",
            ok=not own & set(foreign) and refused == "RECORD_NOT_FOUND",
            detail=f"no record of A's opens to B's view key; asking for one is answered {refusal_text(refused)}",
        )
        probe = await self.stage.wallet("patient-b", ProbeAnswer, "probe", foreign[0])
        self.checks.add(
            "custodians refuse A's records to B",
            ok=set(probe.refusals.values()) <= {"NOT_PERMITTED", "ACCESS_NOT_GRANTED"} and bool(probe.refusals),
            detail="; ".join(f"{name}: {refusal_text(code)}" for name, code in probe.refusals.items()),
        )

    async def tamper(self) -> None:
        record = max(self.state.records["patient-a"], key=lambda row: row.frames)
        index = record.frames // 2
        for node in self.stage.cluster.genesis.custodians:
            await asyncio.to_thread(
                flip_stored_byte, self.stage.cluster.config(node.name), bytes.fromhex(record.record_id), index
            )
        answer = await self.stage.wallet("patient-a", VerifyAnswer, "verify", record.record_id)
        (verdict,) = answer.records
        statuses = {frame.number - 1: frame.status for frame in verdict.frames}
        rest = {status for place, status in statuses.items() if place != index}
        self.checks.add(
            "a changed byte is found, named, and put on the chain",
            ok=verdict.verdict == "corrupted" and statuses[index] == "corrupted" and rest == {"ok"},
            detail=f"picture {index + 1} of record {record.record_id[:8]} is corrupted; "
            f"the other {len(statuses) - 1} open",
        )

    async def erase(self) -> None:
        records = self.state.records["patient-a"]
        traces = await asyncio.to_thread(self._trace, records)
        chosen = next(row for row in records if row.frames >= 4)
        first = await self.stage.wallet(
            "patient-a", EraseAnswer, "erase", chosen.record_id, "--frames", "1,2", "--yes", "--wait"
        )
        out = self.options.out / "pictures" / "after-two"
        seen = await self.stage.wallet("patient-a", ViewAnswer, "view", chosen.record_id, "--out", str(out))
        statuses = [frame.status for frame in seen.records[0].frames]
        self.checks.add(
            "two pictures are erased, the rest stay",
            ok=_confirmed(first) and statuses[:2] == ["erased", "erased"] and "erased" not in statuses[2:],
            detail=f"both custodians destroyed keys and bytes; {what_is_left(statuses)}",
        )
        everything = await self.stage.wallet("patient-a", EraseAnswer, "erase", "--all", "--yes", "--wait")
        listed = await self.stage.wallet("patient-a", RecordsAnswer, "records")
        left = sum(len(visit.records) for visit in listed.visits)
        erased = sum(len(visit.erased_records) for visit in listed.visits)
        self.checks.add(
            "everything of A's is erased",
            ok=_confirmed(everything) and left == 0 and erased == len(records),
            detail=f"{erased} records, {sum(len(row.confirmed) for row in everything.erasures)} receipts on chain",
        )
        told = (await self.stage.wallet("patient-a", ErasuresAnswer, "erasures")).erasures
        words = [word for erasure in told for word in erasure.custodians]
        self.checks.add(
            "A's wallet says who has confirmed what",
            ok=len(words) == 2 * len(told) > 0 and all(word.confirmed_at_ms and not word.overdue for word in words),
            detail=f"{len(told)} erasures, each confirmed by {', '.join(sorted({word.name for word in words}))}",
        )
        refused = await self.stage.refusal("patient-a", "view", chosen.record_id, "--out", str(out))
        self.checks.add(
            "nothing of it can be had any more",
            ok=refused in {"RECORD_NOT_FOUND", "CLIP_ERASED"},
            detail=f"asking for it again is answered {refusal_text(refused)}",
        )
        await self._hunt(traces)
        listed_b = await self.stage.wallet("patient-b", RecordsAnswer, "records")
        kept_b = sum(len(visit.records) for visit in listed_b.visits)
        self.checks.add(
            "patient B's records are untouched",
            ok=kept_b == len(self.state.records["patient-b"]),
            detail=f"{kept_b} records",
        )

    def _trace(self, records: list[RecordRow]) -> list[Trace]:
        return gather(self.stage.cluster, [bytes.fromhex(row.record_id) for row in records])

    async def _hunt(self, traces: list[Trace]) -> None:
        started, cluster = time.monotonic(), self.stage.cluster
        now = await asyncio.to_thread(gather, cluster, [trace.record_id for trace in traces], traces)
        report = await asyncio.to_thread(hunt, cluster, now)
        pieces = sum(len(found) for trace in traces for found in trace.pieces.values())
        left = ", ".join(sorted({f"{finding.what} in {finding.place}" for finding in report.forbidden}))
        self.checks.add(
            "no byte and no key of it is left at any custodian",
            ok=report.is_clean and any(trace.pieces.get("ciphertext") for trace in traces),
            detail=left
            or f"{pieces} pieces of ciphertexts and keys hunted in {report.files_count} files and "
            f"{report.documents_count} documents, {report.size_bytes / 1e6:.0f} MB, in {time.monotonic() - started:.1f} s",
        )

    async def take_along(self) -> None:
        rows = self.state.records["patient-b"][:EXPORTED_COUNT]
        bundle = self.options.out / "patient-b.zip"
        chosen = [argument for row in rows for argument in ("--records", row.record_id)]
        exported = await self.stage.wallet("patient-b", ExportAnswer, "export", str(bundle), *chosen, "--yes")
        told = await run_command(["verify", str(bundle), "--genesis", str(self.stage.genesis_file)], VerifyBundleAnswer)
        self.checks.add(
            "patient B takes records along, and a stranger can check them offline",
            ok=told.is_anchored
            and (exported.problems, told.records, told.metadata_proved) == ([], len(rows), len(rows))
            and told.pictures == sum(row.frames for row in rows),
            detail=f"{told.records} records, {told.pictures} pictures, {exported.bytes / 1e6:.1f} MB, "
            f"proved up to block {told.proved_until_height} from the genesis file alone",
        )

    async def read_trail(self) -> None:
        trail = await self.stage.wallet("patient-a", AuditAnswer, "audit")
        self.state.audit = trail.entries
        kinds = [entry.kind for entry in self.state.audit]
        wanted = ["visit_opened", "recorded", "access_requested", "verdict", "erasure_requested", "erasure_receipted"]
        firsts = [kinds.index(kind) if kind in kinds else -1 for kind in wanted]
        heights = [entry.height for entry in self.state.audit]
        self.checks.add(
            "A's audit trail tells all of it, in order",
            ok=-1 not in firsts and firsts == sorted(firsts) and heights == sorted(heights),
            detail=f"{len(kinds)} entries: {events_text(kinds)}",
        )
        await self._check_agreement()

    async def _check_agreement(self) -> None:
        deadline = time.monotonic() + 10
        while True:
            reports = [report.status for report in await self.stage.cluster.status() if report.status]
            tips = {(status["finalized_height"], status["state_root"]) for status in reports}
            if len(tips) == 1 or time.monotonic() > deadline:
                break
            await asyncio.sleep(0.2)
        self.state.blocks = max(height for height, _ in tips)
        counts = [await read_metric(config, _TRANSACTIONS_METRIC) for config in self.stage.cluster.configs.values()]
        self.state.transactions = int(max(count or 0 for count in counts))
        self.checks.add(
            "all nodes hold the same state",
            ok=len(tips) == 1 and len(reports) == 4,
            detail=f"{len(reports)} nodes at block {self.state.blocks}, {self.state.transactions} transactions",
        )

    async def stop(self) -> None:
        if not self.options.keep:
            await self.stage.stop()


def what_is_left(statuses: list[str]) -> str:
    left = f"{statuses.count('ok')} of {len(statuses)} still open"
    spoilt = statuses.count("corrupted")
    return f"{left}, {spoilt} is the one whose byte was changed before" if spoilt == 1 else left


def _confirmed(answer: EraseAnswer) -> bool:
    return bool(answer.erasures) and all(
        row.status == "complete" and sorted(row.confirmed) == sorted(row.custodians) for row in answer.erasures
    )
