"""A robot on real nodes that is killed and started again, and its person's wallet, which is told all. For tests here.

A life of the robot is its own command in a process of its own (`robot_to_kill`). The wallet is the judge: what was spooled
must be in it exactly once, whole at every custodian, in visits that are closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import time
from asyncio.subprocess import Process
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np

from clients.registrar.registrar import Registrar
from clients.robot.identity.robot_keys import create_identity, load_identity, register_robot
from clients.robot.identity.sealed_file import read_sealed
from clients.robot.recording.spool import SpooledClip
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.sensing.sensor_events import Frame
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.scenario import parse_scenario
from clients.robot.synthetic.scenario_bag import make_bag
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.records.viewing import RecordViewer
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import draw_words
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.records.clips import check_clip_download
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.robot_to_kill import NO_STEP
from tests.walking_alone import UID, walking_alone
from tests.world.dicts import CHEAP

ROOT = Path(__file__).resolve().parents[2]
LIFE_TIMEOUT_S = 120.0
PURPOSE = "demo"
SECONDS = 1.6
SCENE = walking_alone(
    "steps",
    SECONDS,
    [(0.0, -0.6, 4.9), (SECONDS, 0.4, 4.4)],
    [0.1, SECONDS - 0.1],
    frame_rate=10,
    size=(320, 240),
    also_every_s=0.2,
)
SCENE_FILE = "scene.toml"
_KNOWN_FILES = ("robot.keys", "roster.sealed", "client.pin", "events.jsonl", "open-visits", "robot.lock")
_HEARTBEAT_S = 0.4
_PIECE_PX = 320
_FOLLOW_S = 60.0
_NOT_YET = frozenset({"ACCESS_NOT_GRANTED", "CLIP_NOT_CONFIRMED", "NOT_FOUND"})


@dataclass
class Diaries:
    """What all lives together have sealed and spooled, as their diaries and the spool itself tell."""

    sealed: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    spooled: set[str] = field(default_factory=set)
    secrets: set[bytes] = field(default_factory=set)
    reached: list[str] = field(default_factory=list)

    def read(self, path: Path) -> None:
        """Take in the diary of one life."""
        for line in _read(path).splitlines():
            what, value = json.loads(line)
            if what == "sealed":
                self.sealed[value[0]] = [(sequence, at_ms) for sequence, at_ms in value[1]]
            elif what == "spooled":
                self.spooled.add(value)
            elif what == "secret":
                self.secrets.add(bytes.fromhex(value))
            else:
                self.reached.append(value)


class KilledRobot:
    """One robot, its recording and its person. `folder` is for everything; the robot's own is `folder/robots/robot`."""

    def __init__(self, network: NetworkUnderTest, wallet: Wallet, folder: Path, bag: Path) -> None:
        self.network = network
        self.wallet = wallet
        self.folder = folder
        self.bag = bag
        self.robot = folder / "robots" / "robot"
        self.diaries = Diaries()
        self._lives = 0
        self._diary = folder / "diary-0"
        self._viewed: set[bytes] = set()
        self._pieces = _pieces(bag)
        self._destroyed: set[str] = set()

    @property
    def approved(self) -> tuple[str, str]:
        """What has its empty frames approved at the start of a run."""
        return "--approve-as", self.network.organisation

    async def live(self, step: str = NO_STEP) -> dict[str, Any]:
        """Let the robot replay its recording until its end, or until it is killed at `step`. Return its summary."""
        return await self._end(step, await self._start(step, "replay", str(self.bag), "--fast", *self.approved))

    async def watch(self, seconds: float, killed_after_s: float | None = None) -> dict[str, Any]:
        """Let the robot look at the scene live for so long; kill it so long after it has sealed its first clip."""
        process = await self._start(
            NO_STEP, "run", "--scenario", str(self.folder / SCENE_FILE), "--seconds", str(seconds), *self.approved
        )
        if killed_after_s is not None:
            deadline_s = time.monotonic() + LIFE_TIMEOUT_S
            while process.returncode is None and "sealed" not in _read(self._diary):
                assert time.monotonic() < deadline_s, "nothing is sealed"
                await asyncio.sleep(0.05)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), killed_after_s)
            if process.returncode is None:
                process.kill()
        return await self._end(NO_STEP, process)

    async def _start(self, step: str, *arguments: str) -> Process:
        self._lives += 1
        self._diary = self.folder / f"diary-{self._lives}"
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "tests.cluster.robot_to_kill", step, str(self._diary)),
            *("robot", "--robot-dir", str(self.robot.parent), "--genesis", str(self.network.folder / "genesis.json")),
            *(*arguments, "--purpose", PURPOSE, "--clip-ms", "300", "--json"),
            cwd=ROOT,
            env={
                **os.environ,
                "HOME": str(self.folder / "home"),
                "TMPDIR": str(self.folder / "home"),
                "BLOCKROBOT_HOME": str(self.folder),
            },
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )

    async def _end(self, step: str, process: Process) -> dict[str, Any]:
        """Wait for a life's end; look at what it left. Return its summary, an empty one if it was killed."""
        try:
            output, said = await asyncio.wait_for(process.communicate(), LIFE_TIMEOUT_S)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        self.diaries.read(self._diary)
        self.diaries.spooled |= self._spooled()
        if step != NO_STEP:
            assert process.returncode == -signal.SIGKILL, (step, process.returncode, output, said.decode()[-2_000:])
            assert self.diaries.reached[-1] == step
        self.look_at_disk()
        if process.returncode == -signal.SIGKILL:
            return {}
        summary: dict[str, Any] = json.loads(output)
        assert (process.returncode, summary["ok"]) == (0, True), (summary, said.decode()[-2_000:])
        return summary

    def _spooled(self) -> set[str]:
        """The records that wait in the spool, read without opening it as a robot would."""
        key = load_identity(self.robot).spool
        waiting = (self.robot / "spool").glob("[0-9]*.clip")
        return {decode(read_sealed(path, key), SpooledClip).upload.record_id.hex() for path in waiting}

    def look_at_disk(self) -> None:
        """Nothing raw, no key of a picture or a visit, no tag and no name of anybody, wherever the robot can write."""
        names = {path.relative_to(self.robot).as_posix() for path in self.robot.rglob("*") if path.is_file()}
        odd = {name for name in names if name not in _KNOWN_FILES and not _is_own(name)}
        assert odd == set(), "files that a robot should not have"
        handle = self.wallet.store.content.handle
        forbidden = self.diaries.secrets | self._pieces | {UID.encode(), handle, handle.hex().encode()}
        forbidden |= {secret.hex().encode() for secret in self.diaries.secrets}
        for place in (self.robot, self.folder / "home"):
            for path in place.rglob("*"):
                content = path.read_bytes() if path.is_file() else b""
                found = [secret for secret in forbidden if secret in content]
                assert found == [], f"{path.name} holds what must be on no disk"

    async def withdraw(self) -> None:
        """She says no to everything, and what is spooled now is to be destroyed."""
        await ConsentClient(self.wallet).withdraw([], [])
        self._destroyed |= self._spooled()

    async def consent(self) -> None:
        """She says yes to depth."""
        await ConsentClient(self.wallet).give([PURPOSE], ["depth"])

    async def check(self) -> None:
        """All that was spooled is in the wallet once and whole, every visit is closed with its count, and nothing waits."""
        assert list((self.robot / "spool").iterdir()) == []
        assert UnclosedVisitStore(self.robot / "open-visits", load_identity(self.robot).spool).counts == {}
        reports = await self.read()
        entries = [entry for report in reports for entry in report.records]
        ids = [entry.record_id.hex() for entry in entries]
        assert len(ids) == len(set(ids))
        assert set(ids) == self.diaries.spooled - self._destroyed
        assert [report.visit.owner.hex() for report in reports if not report.closed] == []
        assert sum(report.missing_count for report in reports) == 0, "what was never spooled is counted nowhere"
        for report in reports:
            if report.visit.owner not in self._viewed:
                await self._view(report)
                self._viewed.add(report.visit.owner)
        frames = Counter(frame for record_id in ids for frame in self.diaries.sealed[record_id])
        assert [frame for frame, count in frames.items() if count > 1] == []

    async def read(self) -> list[VisitReport]:
        """What the wallet finds, by no older state than any node proves: one may be a block behind what the robot saw."""
        await self.wallet.network.catch_up(self.wallet.keys.identity)
        return await self.wallet.records()

    async def _view(self, report: VisitReport) -> None:
        """Every record of a visit opens, with the frames that were sealed, and every custodian holds it whole."""
        if not report.records:
            return
        viewing = RecordViewer(self.wallet)
        access = await viewing.request_access(list(report.records), PURPOSE)
        for entry in report.records:
            seen = await viewing.view(entry, access)
            assert seen.corrupted == []
            shown = [(f.rendition.sequence, f.rendition.captured_at_ms) for f in seen.frames if f.rendition is not None]
            assert shown == self.diaries.sealed[entry.record_id.hex()] or entry.metadata.sensor != "depth"
            await self._everywhere(entry, access)

    async def _everywhere(self, entry: RecordEntry, access: bytes) -> None:
        custody, key = self.wallet.network.custody, self.wallet.owner_key(entry.visit)
        assert len(custody.custodians) >= 2
        for node in custody.custodians:
            async with asyncio.timeout(_FOLLOW_S):
                while True:
                    try:
                        clip = await custody.download_clip(node, entry.record_id, access, key)
                        break
                    except BlockRobotError as error:
                        if error.code not in _NOT_YET:
                            raise
                        await asyncio.sleep(0.1)
            assert check_clip_download(clip, entry.state.commitment_root, entry.state.ciphertext_root) == []


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.exists() else ""


def _is_own(name: str) -> bool:
    """A clip, or a file that a kill left unfinished."""
    folder, _, file = name.rpartition("/")
    if folder == "spool":
        return file.endswith(".clip") and file.removeprefix(".tmp-").removesuffix(".clip").isdecimal()
    return folder == "" and (file == ".tmp-open-visits" or file.startswith(".client.pin."))


def _pieces(bag: Path) -> set[bytes]:
    """Pieces of raw frames: of each, the row that is least like any other bytes."""
    pieces = set()
    for event in BagSource(bag).events():
        if isinstance(event, Frame):
            windows = event.depth.reshape(-1, _PIECE_PX)
            kinds = [np.unique(window).size for window in windows]
            assert max(kinds) > 10, "a piece that could be in any file would say nothing"
            pieces.add(windows[int(np.argmax(kinds))].tobytes())
    return pieces


@contextlib.asynccontextmanager
async def killed_robot(network: NetworkUnderTest, folder: Path) -> AsyncIterator[KilledRobot]:
    """Enrol a person who consents and a robot; keep the chain going meanwhile, since an idle one proves little."""
    bag = await asyncio.to_thread(make_bag, parse_scenario(SCENE), {"ann": UID}, folder / "bags", workers=1)
    genesis = network.genesis
    (folder / "genesis.json").write_bytes((network.folder / "genesis.json").read_bytes())
    (folder / "home").mkdir()
    (folder / "recordings").mkdir()
    (folder / "recordings" / "tags.json").write_text(json.dumps({"ann": UID}), encoding="utf-8")
    (folder / SCENE_FILE).write_text(SCENE, encoding="utf-8")
    desk = Registrar(network.folder / "organisations" / genesis.organisations[0].name, genesis)
    going = asyncio.create_task(_keep_going(network))
    try:
        store = Keystore.create(folder / "ann.wallet", draw_words(), "tea", CHEAP)
        async with Wallet(store, genesis) as wallet:
            robot = KilledRobot(network, wallet, folder, bag)
            await wallet.register(desk.issue(UID, "subject"), [])
            await robot.consent()
            identity = create_identity(robot.robot)
            await register_robot(robot.robot, identity, desk.issue("0BADF00D", "robot"), genesis)
            made = await desk.make_roster(identity.identity.public_key)
            sealed, rows = made.sealed, made.rows
            assert rows == 1
            (robot.robot / "roster.sealed").write_bytes(sealed)
            yield robot
    finally:
        going.cancel()
        await asyncio.gather(going, return_exceptions=True)


async def _keep_going(network: NetworkUnderTest) -> None:
    while True:
        with contextlib.suppress(aiohttp.ClientError, TimeoutError):
            await network.submit(network.names[0], [network.transaction()])
        await asyncio.sleep(_HEARTBEAT_S)
