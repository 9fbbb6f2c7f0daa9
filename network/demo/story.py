"""The story, step by step: network, people, recording, a killed leader, looking, tampering, erasing, report.

Robot, wallets and registrar are processes of their own that know the genesis file and HTTP. Must never take a step's own
word for a check that can be made from another side.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clients.robot.bag import make_bag
from clients.robot.pairing import WINDOW_DEFAULT_MS
from clients.robot.scenario import Scenario, published_run_1
from clients.robot.synthetic_recording import load_or_draw_tags
from consensus.errors import BlockRobotError
from network.cluster import Cluster, read_metric
from network.demo.checks import CheckList
from network.demo.leader_kill import LeaderKill, kill_and_restart_leader
from network.demo.processes import LongCommand, run_command, wallet_arguments
from network.demo.scene_truth import FOREIGN_PIXELS_MAX_SHARE, worst_foreign_share
from network.demo.tampering import drop_databases, flip_stored_byte
from network.layout import create_network

RECORDING_TIMEOUT_S = 150.0
PEERS_MAX_S = 10.0
WITHHELD_MAX_SHARE = 0.30
_TRANSACTIONS_METRIC = "blockrobot_transactions_finalized_total"
PURPOSE = "demo"
PATIENTS = ("patient-a", "patient-b")


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """Where the demonstration writes, where recordings are cached, which store custodians use, the first port."""

    out: Path
    cache: Path
    store: str
    base_port: int
    keep: bool


@dataclass(slots=True)
class DemoState:
    """What the steps learn from each other."""

    robot_member: str = ""
    summary: dict[str, Any] = field(default_factory=dict)
    kill: LeaderKill | None = None
    records: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    pictures: dict[str, list[Path]] = field(default_factory=dict)
    audit: list[dict[str, Any]] = field(default_factory=list)
    blocks: int = 0
    transactions: int = 0


class Demo:
    """One run of the story. `tell` is given a line on what is being done; checks go to `checks`."""

    def __init__(self, options: DemoOptions, checks: CheckList, tell: Callable[[str], None]) -> None:
        self.options = options
        self.checks = checks
        self.state = DemoState()
        self.scenario: Scenario = published_run_1()
        self._tell = tell
        self._network_dir = options.out / "network"
        self._wallets = options.out / "wallets"
        self._robots = options.out / "robots"
        self.cluster: Cluster | None = None

    @property
    def running(self) -> Cluster:
        """The running cluster. Raises CLUSTER_NOT_RUNNING before it was started."""
        if self.cluster is None:
            raise BlockRobotError("CLUSTER_NOT_RUNNING")
        return self.cluster

    @property
    def _genesis(self) -> Path:
        return self._network_dir / "genesis.json"

    async def run(self) -> None:
        """Run all steps in order. What a step raises becomes a failed check, and the story ends there."""
        steps: list[tuple[str, Callable[[], Any]]] = [
            ("the recording is rendered", self.render),
            ("the network starts", self.start_network),
            ("people and robot are enrolled", self.enrol),
            ("the robot records", self.record),
            ("patients look at their records", self.look),
            ("a stored byte is changed", self.tamper),
            ("patient A erases", self.erase),
            ("the trail is read", self.read_trail),
        ]
        for name, step in steps:
            self._tell(name)
            try:
                await step()
            except BlockRobotError as error:
                self.checks.add(name, ok=False, detail=f"{error.code}: {error.detail}")
                return

    async def render(self) -> None:
        """Render the recording, or find it in the cache."""
        started = time.monotonic()
        tags = load_or_draw_tags(self.options.cache, self.scenario)
        shown = -1

        def progress(done: int, total: int) -> None:
            nonlocal shown
            if done * 10 // total > shown:
                shown = done * 10 // total
                self._tell(f"rendering the recording: {done} of {total} frames")

        self._bag = await asyncio.to_thread(make_bag, self.scenario, tags, self.options.cache, progress=progress)
        self._tags = tags
        self._tell(f"the recording is there ({time.monotonic() - started:.0f} s)")

    async def start_network(self) -> None:
        """Make and start four node processes of two organisations, and wait until each is ready."""
        started = time.monotonic()
        create_network(
            self._network_dir,
            nodes=4,
            organisations=2,
            base_port=self.options.base_port,
            store=self.options.store,
            network=f"demo-{secrets.token_hex(4)}",
            faults=True,
        )
        self.cluster = Cluster(self._network_dir)
        self.cluster.start_all()
        await self.cluster.wait_ready()
        peers = await self._count_peers()
        self.checks.add(
            "4 nodes of 2 organisations are ready",
            ok=len(peers) == 4 and min(peers) == 3,
            detail=f"each in touch with {min(peers, default=0)} peers over mutual TLS, "
            f"after {time.monotonic() - started:.1f} s",
        )

    async def _count_peers(self) -> list[int]:
        """Return how many peers each node is in touch with, once all are with all (a quorum is ready a little sooner)."""
        deadline = time.monotonic() + PEERS_MAX_S
        while True:
            reports = await self.running.status()
            peers = [len(report.status["peers"]) for report in reports if report.status]
            if min(peers, default=0) == len(reports) - 1 or time.monotonic() > deadline:
                return peers
            await asyncio.sleep(0.1)

    def _desk(self) -> list[str]:
        organisation = self.running.genesis.organisations[0].name
        return ["--desk", str(self._network_dir / "organisations" / organisation), "--genesis", str(self._genesis)]

    def _wallet(self, profile: str) -> list[str]:
        return wallet_arguments(self._wallets, profile, self._genesis)

    def _robot(self) -> list[str]:
        return ["robot", "--robot-dir", str(self._robots), "--genesis", str(self._genesis)]

    async def _wallet_command(self, profile: str, *arguments: str) -> dict[str, Any]:
        environment = {"BLOCKROBOT_PASSPHRASE_FILE": str(self._wallets / f"{profile}.passphrase")}
        return await run_command([*self._wallet(profile), *arguments], environment=environment)

    async def _issue_card(self, role: str, alias: str, uid: str) -> str:
        uid_file = self._wallets / f"{alias}.uid"
        _write_private(uid_file, uid)
        answer = await run_command(["card", "issue", *self._desk(), "--role", role, "--uid-file", str(uid_file)])
        uid_file.unlink()
        return str(answer["code"])

    async def enrol(self) -> None:
        """Issue cards, make wallets, register them and the robot, and seal the robot's roster."""
        self._wallets.mkdir(parents=True, exist_ok=True, mode=0o700)
        members = {}
        for patient in PATIENTS:
            _write_private(self._wallets / f"{patient}.passphrase", secrets.token_urlsafe(16))
            code = await self._issue_card("subject", patient, self._tags[patient])
            words = self._wallets / f"{patient}.words"
            made = await self._wallet_command(patient, "new", "--fast-passphrase", "--words-file", str(words))
            registered = await self._wallet_command(patient, "register", code, "--purpose", PURPOSE)
            members[patient] = (made["member"], registered["member"])
        held = all(own == on_chain for own, on_chain in members.values())
        self.checks.add(
            "two patients are registered",
            ok=held,
            detail="the key that the contract recovered from each signature is the wallet's own",
        )
        made = await run_command([*self._robot(), "new"])
        code = await self._issue_card("robot", "robot", secrets.token_hex(12).upper())
        registered = await run_command([*self._robot(), "register", code])
        self.state.robot_member = registered["member"]
        roster = self._robots / "robot" / "roster.sealed"
        answer = await run_command(
            ["roster", "make", *self._desk(), "--robot", self.state.robot_member, "--out", str(roster)]
        )
        self.checks.add(
            "the robot has its sealed roster",
            ok=made["member"] == registered["member"] and answer["rows"] == len(PATIENTS),
            detail=f"{answer['rows']} people; only this robot can open it",
        )

    async def record(self) -> None:
        """Let the robot record in real time; kill the leader when half of the frames are recorded, restart it later."""
        expected_kept = self._expected_covered() // 2
        kill: asyncio.Task[LeaderKill] | None = None

        def progress(figures: dict[str, Any]) -> None:
            nonlocal kill
            read, recorded, waiting = figures["frames_read"], figures["frames_recorded"], figures["waiting"]
            self._tell(f"recording: {read} frames seen, {recorded} recorded, {waiting} clips on their way")
            if kill is None and recorded >= expected_kept:
                self._tell("killing the leading node")
                kill = asyncio.create_task(kill_and_restart_leader(self.running))

        arguments = [*self._robot(), "replay", str(self._bag), "--purpose", PURPOSE]
        arguments += ["--events", str(self.options.out / "events.jsonl")]
        self.state.summary = await LongCommand(arguments, progress).run(RECORDING_TIMEOUT_S)
        self._check_frames()
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
        """Return how many (frame, owner) pairs the readings cover, worked out from the scenario alone."""
        covered = 0
        for person in self.scenario.people:
            times = person.reading_times_s() if person.tagged else []
            for index in range(self.scenario.frame_count):
                at_ms = round(1000 * index / self.scenario.frame_rate)
                covered += any(abs(at_ms - round(1000 * reading)) <= WINDOW_DEFAULT_MS for reading in times)
        return covered

    def _check_frames(self) -> None:
        frames = self.state.summary["frames"]
        rows = self.state.summary["roster_rows"]
        self.checks.add(
            "the robot proves its roster against the chain",
            ok=rows == len(PATIENTS),
            detail=f"{rows} people, each row equal to what a finalized header proves",
        )
        self.checks.add(
            "every frame of the camera arrived",
            ok=frames["published"] == self.scenario.frame_count,
            detail=f"{frames['published']} of {self.scenario.frame_count}",
        )
        expected = self._expected_covered()
        self.checks.add(
            "the right frames were paired",
            ok=frames["covered"] == expected,
            detail=f"{frames['covered']} frames and owners, {expected} by the scenario's own readings",
        )
        self.checks.add(
            "no frame that should be kept is lost",
            ok=frames["lost"] == 0 and frames["covered"] == frames["kept"] + frames["withheld"],
            detail=f"covered {frames['covered']} = kept {frames['kept']} + withheld {frames['withheld']}",
        )
        share = frames["withheld"] / max(1, frames["covered"])
        reasons = ", ".join(f"{reason} {count}" for reason, count in frames["withheld_reasons"].items()) or "none"
        self.checks.add(
            "at most 30 % were withheld, each with its reason",
            ok=share <= WITHHELD_MAX_SHARE and sum(frames["withheld_reasons"].values()) == frames["withheld"],
            detail=f"{100 * share:.1f} %: {reasons}",
        )

    async def look(self) -> None:
        """Both patients list, fetch, verify and open their records; neither can reach the other's."""
        for patient in PATIENTS:
            listed = await self._wallet_command(patient, "records")
            self.state.records[patient] = [row for visit in listed["visits"] for row in visit["records"]]
            missing = sum(visit["missing_records"] for visit in listed["visits"])
            closed = all(visit["closed"] for visit in listed["visits"])
            frames = sum(row["frames"] for row in self.state.records[patient])
            self.checks.add(
                f"{patient} finds all her records",
                ok=bool(self.state.records[patient]) and missing == 0 and closed,
                detail=f"{len(self.state.records[patient])} records, {frames} pictures, none missing",
            )
            out = self.options.out / "pictures" / patient
            seen = await self._wallet_command(patient, "view", "--out", str(out), "--purpose", "own-access")
            statuses = [frame["status"] for record in seen["records"] for frame in record["frames"]]
            self.state.pictures[patient] = sorted(out.glob("*/*[0-9].png"))
            self.checks.add(
                f"{patient} opens and verifies them",
                ok="ok" in statuses and set(statuses) <= {"ok", "notice"},
                detail=f"{statuses.count('ok')} pictures, against a header proven final from the genesis file",
            )
            own = sorted(out.glob("*/*.depth.png"))
            worst, judged = await asyncio.to_thread(worst_foreign_share, self.scenario, own, patient)
            self.checks.add(
                f"{patient}'s pictures show nobody else",
                ok=judged > 0 and worst <= FOREIGN_PIXELS_MAX_SHARE,
                detail=f"{judged} pictures taken while others stood in view; "
                f"at most {100 * worst:.3f} % of their pixels in any",
            )
        await self._check_strangers()

    async def _check_strangers(self) -> None:
        own = {row["record_id"] for row in self.state.records["patient-b"]}
        foreign = [row["record_id"] for row in self.state.records["patient-a"]]
        refused = await self._refusal("patient-b", "view", foreign[0], "--out", str(self.options.out / "none"))
        self.checks.add(
            "patient B's wallet cannot tell which records are A's, nor fetch them",
            ok=not own & set(foreign) and refused == "NOT_FOUND",
            detail="no record of A's opens to B's view key",
        )
        probe = await run_command(
            [*self._wallet("patient-b"), "probe", foreign[0]],
            environment={"BLOCKROBOT_PASSPHRASE_FILE": str(self._wallets / "patient-b.passphrase")},
        )
        self.checks.add(
            "custodians refuse A's records to B",
            ok=set(probe["refusals"].values()) <= {"NOT_PERMITTED", "ACCESS_NOT_GRANTED"} and bool(probe["refusals"]),
            detail="; ".join(f"{name}: {code}" for name, code in probe["refusals"].items()),
        )

    async def _refusal(self, patient: str, *arguments: str) -> str:
        """Return the code with which a wallet's command is refused, or an empty text if it is not."""
        try:
            await self._wallet_command(patient, *arguments)
        except BlockRobotError as error:
            return error.code
        return ""

    async def tamper(self) -> None:
        """Flip one bit in both custodians' stores; the wallet names the frame, opens the rest, says so on the chain."""
        record = max(self.state.records["patient-a"], key=lambda row: int(row["frames"]))
        index = int(record["frames"]) // 2
        for node in self.running.genesis.custodians:
            await asyncio.to_thread(
                flip_stored_byte, self.running.config(node.name), bytes.fromhex(record["record_id"]), index
            )
        answer = await self._wallet_command("patient-a", "verify", record["record_id"])
        (verdict,) = answer["records"]
        statuses = {frame["index"]: frame["status"] for frame in verdict["frames"]}
        rest = {status for place, status in statuses.items() if place != index}
        self.checks.add(
            "a changed byte is found, named, and put on the chain",
            ok=verdict["verdict"] == "corrupted" and statuses[index] == "corrupted" and rest == {"ok"},
            detail=f"picture {index} of record {record['record_id'][:8]} is corrupted; "
            f"the other {len(statuses) - 1} open",
        )

    async def erase(self) -> None:
        """Erase two frames, then everything; wait for the custodians' receipts each time."""
        records = self.state.records["patient-a"]
        chosen = next(row for row in records if int(row["frames"]) >= 4)
        first = await self._wallet_command(
            "patient-a", "erase", chosen["record_id"], "--frames", "0,1", "--yes", "--wait"
        )
        out = self.options.out / "pictures" / "after-two"
        seen = await self._wallet_command("patient-a", "view", chosen["record_id"], "--out", str(out))
        statuses = [frame["status"] for frame in seen["records"][0]["frames"]]
        self.checks.add(
            "two pictures are erased, the rest stay",
            ok=_confirmed(first) and statuses[:2] == ["erased", "erased"] and "erased" not in statuses[2:],
            detail=f"both custodians destroyed keys and bytes; {statuses.count('ok')} of {len(statuses)} still open",
        )
        everything = await self._wallet_command("patient-a", "erase", "--all", "--yes", "--wait")
        listed = await self._wallet_command("patient-a", "records")
        left = sum(len(visit["records"]) for visit in listed["visits"])
        erased = sum(len(visit["erased_records"]) for visit in listed["visits"])
        self.checks.add(
            "everything of A's is erased",
            ok=_confirmed(everything) and left == 0 and erased == len(records),
            detail=f"{erased} records, {sum(len(row['confirmed']) for row in everything['erasures'])} receipts on chain",
        )
        refused = await self._refusal("patient-a", "view", chosen["record_id"], "--out", str(out))
        self.checks.add(
            "nothing of it can be had any more",
            ok=refused in {"NOT_FOUND", "CLIP_ERASED"},
            detail=f"asking for it again is answered {refused or 'with the record'}",
        )
        listed_b = await self._wallet_command("patient-b", "records")
        kept_b = sum(len(visit["records"]) for visit in listed_b["visits"])
        self.checks.add(
            "patient B's records are untouched",
            ok=kept_b == len(self.state.records["patient-b"]),
            detail=f"{kept_b} records",
        )

    async def read_trail(self) -> None:
        """Read A's audit trail and hold it against what was done."""
        trail = await self._wallet_command("patient-a", "audit")
        self.state.audit = trail["entries"]
        kinds = [entry["kind"] for entry in self.state.audit]
        wanted = ["visit_opened", "recorded", "access_requested", "verdict", "erasure_requested", "erasure_receipted"]
        firsts = [kinds.index(kind) if kind in kinds else -1 for kind in wanted]
        heights = [entry["height"] for entry in self.state.audit]
        self.checks.add(
            "A's audit trail tells all of it, in order",
            ok=-1 not in firsts and firsts == sorted(firsts) and heights == sorted(heights),
            detail=f"{len(kinds)} entries: {', '.join(dict.fromkeys(kinds))}",
        )
        await self._check_agreement()

    async def _check_agreement(self) -> None:
        """Compare the nodes' finalized state at the end."""
        deadline = time.monotonic() + 10
        while True:
            reports = [report.status for report in await self.running.status() if report.status]
            tips = {(status["finalized_height"], status["state_root"]) for status in reports}
            if len(tips) == 1 or time.monotonic() > deadline:
                break
            await asyncio.sleep(0.2)
        self.state.blocks = max(height for height, _ in tips)
        counts = [await read_metric(config, _TRANSACTIONS_METRIC) for config in self.running.configs.values()]
        self.state.transactions = int(max(count or 0 for count in counts))
        self.checks.add(
            "all nodes hold the same state",
            ok=len(tips) == 1 and len(reports) == 4,
            detail=f"{len(reports)} nodes at block {self.state.blocks}, {self.state.transactions} transactions",
        )

    async def stop(self) -> None:
        """Stop the network, unless it is to be kept."""
        if self.cluster is not None and not self.options.keep:
            await asyncio.to_thread(self.cluster.stop_all)
            await asyncio.to_thread(drop_databases, self.cluster)


def _confirmed(answer: dict[str, Any]) -> bool:
    """Tell whether every erasure of an answer is complete and confirmed by each of its custodians."""
    return bool(answer["erasures"]) and all(
        row["status"] == "complete" and sorted(row["confirmed"]) == sorted(row["custodians"])
        for row in answer["erasures"]
    )


def _write_private(path: Path, text: str) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(text)
