"""The running console: watches the network, records it and applies faults."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import structlog

from consensus.errors import BlockRobotError
from consensus.visible_text import split_lines
from network.byzantine import BEHAVIOURS
from network.cluster import Cluster
from network.console.console_documents import (
    Choice,
    Choices,
    NetworkFacts,
    NodeFacts,
    Now,
    Past,
    PlanStatus,
    Recording,
    StepError,
    StepStatus,
)
from network.console.export import write_export
from network.console.node_polling import NodePoll, NodePoller
from network.console.recorder import Recorder
from network.console.rounds import ROUNDS_KEPT_COUNT, RoundBook
from network.console.snapshots import ConsoleSnapshot, SnapshotBuilder
from network.console.timeline import Timeline, make_event
from network.faults.actions import LINK_PROFILES, Restart
from network.faults.control import FaultControl
from network.faults.plan import FaultPlan, parse_plan
from network.faults.requested import StepDone, carry_out_requested, open_control, read_action, run_plan
from node.config import CONFIG_FILE
from node.faults import DISKS
from pages.serving import PAGES_ASSETS


def _wall_ms() -> int:
    return time.time_ns() // 1_000_000


class ForwardClock:
    """Follows the machine's clock; after a setback it continues, ahead by as much."""

    def __init__(self, wall_ms: Callable[[], int] = _wall_ms) -> None:
        self._wall_ms = wall_ms
        self._last_ms = 0
        self._ahead_ms = 0

    def now_ms(self) -> int:
        now_ms = self._wall_ms() + self._ahead_ms
        if now_ms < self._last_ms:
            self._ahead_ms += self._last_ms - now_ms
            now_ms = self._last_ms
        self._last_ms = now_ms
        return now_ms


CONSOLE_ASSETS = Path(__file__).parent / "assets"
INTERVAL_MS = 500
LARGE_INTERVAL_MS = 1_000
SMALL_NETWORK_MAX_COUNT = 7
ROUNDS_SHOWN_COUNT = 48
TEXT_MAX_CHARS = 1_000

log = structlog.get_logger(__name__)


class LiveConsole:
    """One network, watched and recorded; `run` and all methods share one event loop."""

    def __init__(self, cluster: Cluster, now_ms: Callable[[], int] | None = None) -> None:
        """`now_ms` is monotonic: recorded times stay in order if the system clock jumps."""
        self.cluster = cluster
        self._now_ms = now_ms or ForwardClock().now_ms
        self.started_ms = self._now_ms()
        self.recorder = Recorder()
        self.sequence = 0
        self.moment: ConsoleSnapshot | None = None
        self._genesis = self._read_genesis()
        self._began()
        self._news = asyncio.Event()
        self._plan: _RunningPlan | None = None
        self._trouble = ""

    def _began(self) -> None:
        configs = self.cluster.configs.items()
        producers = [name for name, config in configs if config.producer_key_path is not None]
        self._rounds = RoundBook(len(producers) - (len(producers) - 1) // 3, producers)
        self._timeline = Timeline()
        self._maker = SnapshotBuilder(time.monotonic())
        self.moment = None

    def _read_genesis(self) -> bytes:
        try:
            return (self.cluster.folder / "genesis.json").read_bytes()
        except OSError:
            return b""

    # Looking

    async def run(self) -> None:
        while True:
            await self._watch_same_network()

    async def _watch_same_network(self) -> None:
        count = len(self.cluster.names)
        interval_s = (INTERVAL_MS if count <= SMALL_NETWORK_MAX_COUNT else LARGE_INTERVAL_MS) / 1000
        async with NodePoller(self.cluster) as poller:
            while not (self._is_another() and self._begin_anew()):
                started_s = time.monotonic()
                try:
                    self._update(await poller.poll())
                    self._trouble = ""
                except Exception as error:  # noqa: BLE001 - whatever a node says, the next look may work again
                    self._report_failure(error)
                await asyncio.sleep(max(0.05, started_s + interval_s - time.monotonic()))

    def _report_failure(self, error: Exception) -> None:
        trouble = f"{type(error).__name__}: {error}"
        if trouble != self._trouble:
            self._trouble = trouble
            log.warning("refresh_failed", error=type(error).__name__, detail=str(error))
            self._add_event("node", f"The console cannot see the network: {type(error).__name__}.", "bad")

    def _update(self, polls: list[NodePoll]) -> None:
        wall_ms = self._now_ms()
        rounds = self._rounds.update(polls, wall_ms)
        self.recorder.note_network(wall_ms, self.facts())
        moment = self._maker.update(polls, time.monotonic(), wall_ms)
        for node in moment["nodes"]:
            node["state"] = self._without_places(node["state"])
        self.recorder.add(moment, self._timeline.update(moment, rounds))
        self.moment = moment
        self._wake_waiting()

    def _wake_waiting(self) -> None:
        self.sequence += 1
        self._news.set()
        self._news = asyncio.Event()

    def _is_another(self) -> bool:
        folder = self.cluster.folder
        names = {path.parent.name for path in (folder / "nodes").glob(f"*/{CONFIG_FILE}")}
        return bool(names) and (names != set(self.cluster.names) or self._read_genesis() not in {self._genesis, b""})

    def _begin_anew(self) -> bool:
        genesis, before = self._read_genesis(), set(self.cluster.names)
        is_new_chain = genesis != self._genesis
        try:
            self.cluster = Cluster(self.cluster.folder)
        except (BlockRobotError, OSError, ValueError):
            return False
        if is_new_chain:
            self.stop_plan()  # it was meant for the other network
            self._genesis = genesis
            self._began()
        what = "Another network stands in the folder now" if is_new_chain else "The nodes are others now"
        others = () if is_new_chain else tuple(sorted(before ^ set(self.cluster.names)))
        self._add_event("node", f"{what}: {', '.join(self.cluster.names)}.", "", others)
        return True

    async def wait_beyond(self, sequence: int, timeout_s: float) -> None:
        try:
            async with asyncio.timeout(timeout_s):
                while self.sequence <= sequence:
                    await self._news.wait()
        except TimeoutError:
            return

    # What the page is told

    def facts(self) -> NetworkFacts:
        cluster = self.cluster
        organisations = {node.name: node.organisation for node in cluster.genesis.nodes}
        nodes = [
            NodeFacts(
                name,
                organisation=organisations.get(name) or config.organisation,
                producer=name in self._rounds.producers,
                custodian=config.custodian_key_path is not None,
                breakable=config.faults_enabled,
            )
            for name, config in cluster.configs.items()
        ]
        return NetworkFacts(cluster.genesis.network, self._rounds.quorum, nodes)

    def choices(self) -> Choices:
        return Choices(
            behaviours=[Choice(name, _meaning(kind)) for name, kind in BEHAVIOURS.items()],
            profiles=[Choice(name, profile.meaning) for name, profile in LINK_PROFILES.items()],
            disks=list(DISKS),
            folder=str(self.cluster.folder),
        )

    def now(self, after_event: int) -> Now:
        """With events after `after_event`."""
        moment = self.moment
        return Now(
            sequence=self.sequence,
            network=(self.recorder.network_at(moment["at_ms"]) if moment else None) or self.facts(),
            moment=moment,
            rounds=self._rounds.last(ROUNDS_SHOWN_COUNT),
            events=self.recorder.events_after(after_event),
            plan=None if self._plan is None else self._plan.describe(),
            recording=self.recording(),
        )

    def past(self, at_ms: int) -> Past:
        moment = self.recorder.moment_at(at_ms)
        network = self.recorder.network_at(moment["at_ms"]) if moment else None
        until_ms = max(at_ms, moment["at_ms"]) if moment else at_ms
        rounds = [each for each in self._rounds.last(ROUNDS_KEPT_COUNT) if each.at_ms <= until_ms]
        return Past(moment, network, rounds[-ROUNDS_SHOWN_COUNT:])

    def recording(self) -> Recording:
        recorder = self.recorder
        return Recording(
            since_ms=self.started_ms,
            names=recorder.names() or list(self.cluster.names),
            moments=recorder.moments_count,
            size_bytes=recorder.size_bytes,
            dropped=recorder.dropped(self._rounds.dropped_count),
        )

    def export(self) -> str:
        facts = {
            "network": self.facts(),
            "networks": self.recorder.networks(),
            "exported_ms": self._now_ms(),
            "recording": self.recording(),
            "events": self.recorder.events_after(0),
            "rounds": self._rounds.last(ROUNDS_KEPT_COUNT),
        }
        return write_export(msgspec.to_builtins(facts), self.recorder.moments_json(), read_page_files())

    # Breaking

    async def do(self, fields: Mapping[str, Any]) -> str:
        """Return what was done. Raises as `blockrobot fault` does."""
        action, seed = read_action(fields, tuple(self.cluster.names))
        is_start = isinstance(action, Restart)
        control = FaultControl(self.cluster, seed) if is_start else open_control(self.cluster, seed)
        words, nodes = action.describe(), action.touched()
        self._add_event("asked", f"Asked: {words}.", "", nodes)
        try:
            await carry_out_requested(control, action)
        except BlockRobotError as error:
            self._add_event("asked", f"Refused: {words}. {error.code}: {error.detail}", "bad", nodes)
            raise
        self._add_event("asked", f"Done: {words}.", "", nodes)
        return words

    def _add_event(self, kind: str, text: str, tone: str, nodes: tuple[str, ...] = ()) -> None:
        shown_text = self._without_places(text)
        self.recorder.tell(make_event(self._now_ms(), kind, shown_text[:TEXT_MAX_CHARS], tone, nodes))
        self._wake_waiting()

    def _without_places(self, text: str) -> str:
        return text.replace(str(self.cluster.folder), "(the network's folder)").replace(str(Path.home()), "~")

    def read_plan(self, text: str) -> FaultPlan:
        """Without running it. Raises FAULT_PLAN_INVALID."""
        return parse_plan(text, self.cluster.names)

    def start_plan(self, text: str) -> PlanStatus:
        """Raises FAULT_PLAN_INVALID, FAULT_PLAN_RUNNING, CLUSTER_NOT_RUNNING."""
        if self._plan is not None and self._plan.is_running:
            raise BlockRobotError("FAULT_PLAN_RUNNING")
        open_control(self.cluster)
        plan = self.read_plan(text)
        self._plan = _RunningPlan(plan, self)
        self._add_event("asked", f"A plan of {len(plan.steps)} steps with seed {plan.seed} begins.", "")
        return self._plan.describe()

    def stop_plan(self) -> None:
        if self._plan is not None and self._plan.stop():
            self._add_event("asked", "The plan is stopped; what it switched on is still on.", "")

    async def close(self) -> None:
        if self._plan is not None and self._plan.stop():
            await asyncio.gather(self._plan.task, return_exceptions=True)

    def note_step(self, done: StepDone) -> None:
        words, nodes = done.step.action.describe(), done.step.action.touched()
        if done.error is None:
            self._add_event("asked", f"Plan, {done.at_ms / 1000:.1f} s: {words}.", "", nodes)
        else:
            text = f"Plan, {done.at_ms / 1000:.1f} s: {words} refused. {done.error.code}: {done.error.detail}"
            self._add_event("asked", text, "bad", nodes)


class _RunningPlan:
    """A plan that runs or has run."""

    def __init__(self, plan: FaultPlan, console: LiveConsole) -> None:
        self._plan = plan
        self._console = console
        self._done: list[StepDone] = []
        self._is_stopped = False
        control = FaultControl(console.cluster, plan.seed)
        self.task = asyncio.get_running_loop().create_task(run_plan(plan, control, self._note), name="fault-plan")

    @property
    def is_running(self) -> bool:
        return not self.task.done()

    def stop(self) -> bool:
        if self.task.done():
            return False
        self._is_stopped = True
        return self.task.cancel()

    def _note(self, done: StepDone) -> None:
        self._done.append(done)
        self._console.note_step(done)

    def describe(self) -> PlanStatus:
        shown_text = describe_plan(self._plan)
        for step, done in zip(shown_text.steps, self._done, strict=False):
            step.done_at_ms = done.at_ms
            if done.error is not None:
                step.error = StepError(done.error.code, done.error.detail)
        shown_text.state = "running" if self.is_running else "stopped" if self._is_stopped else "done"
        return shown_text


def describe_plan(plan: FaultPlan) -> PlanStatus:
    return PlanStatus(plan.seed, [StepStatus(step.at_ms, step.line, step.action.describe()) for step in plan.steps])


def _meaning(behaviour: type) -> str:
    return split_lines((behaviour.__doc__ or "").strip())[0]


def read_page_files() -> dict[str, str]:
    files = {}
    for prefix, folder in (("shared/", PAGES_ASSETS), ("", CONSOLE_ASSETS)):
        for path in sorted((*folder.glob("*.js"), *folder.glob("*.css"))):
            files[prefix + path.name] = path.read_text(encoding="utf-8")
    return files
