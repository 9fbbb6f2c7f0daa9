"""Rights on real nodes: restricted, corrected, denied, decided by an officer, objected to; each as people do it.

One story from the robot to the custodians: what the person says in her wallet is what custodians do from that block on,
also under a request that was open.
"""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

import pytest

from clients.officer.breaches import Breaches
from clients.registrar.registrar import Registrar
from clients.robot.identity.robot_keys import create_identity, register_robot
from clients.robot.recording.frame_answers import FrameCounts
from clients.robot.run.run_summary import RunSummary
from clients.robot.run.runner import ReplayOptions, replay_recording
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.scenario import parse_scenario
from clients.robot.synthetic.scenario_bag import make_bag
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.visit_audit import audit_all
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.records.rights_requests import RecordChoice, Rights
from clients.wallet.records.viewing import RecordViewer
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import draw_words
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.rights.right_codes import commit_correction
from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest
from tests.walking_alone import UID, walking_alone
from tests.world.dicts import CHEAP

SCENE = walking_alone("pace", 3.0, [(0.0, -0.5, 2.5), (3.0, 0.5, 2.0)], [0.1, 0.5, 0.9, 1.3, 1.7, 2.1, 2.5])


def quiet(_: int, __: int) -> None:
    """Nobody listens."""


def nobody(_: dict[str, Any], *, last: bool = False) -> None:
    """Nobody asks how far the robot is."""


class Ward:
    """A robot with a roster and a recording on a network, and wallets of people there."""

    def __init__(self, network: NetworkUnderTest, folder: Path) -> None:
        self.network = network
        self.genesis: Genesis = network.genesis
        self.folder = folder
        self.desk = Registrar(network.folder / "organisations" / self.genesis.organisations[0].name, self.genesis)

    def wallet(self, name: str) -> Wallet:
        return Wallet(Keystore.create(self.folder / f"{name}.wallet", draw_words(), "tea", CHEAP), self.genesis)

    async def told_everywhere(self, height: int = 0) -> None:
        """Wait until every node that runs has what is final at any of them, and this height: clients may ask any node.

        A yes holds from the block after its own on (`ConsentDecision.from_height`). That one holds nothing, and is
        final a moment later, on a busy machine more than a second: a robot that starts in between keeps nothing yet.
        """
        cluster = self.network.cluster
        up = [name for name in cluster.names if cluster.is_running(name) and not cluster.is_paused(name)]
        newest = max([height, *[(await self.network.status(name))["finalized_height"] for name in up]])
        for name in up:
            await self.network.wait_height(name, newest)

    async def prepare_robot(self, scene: str = SCENE) -> None:
        self.bag = await asyncio.to_thread(
            make_bag, parse_scenario(scene), {"ann": UID}, self.folder / "bags", workers=1
        )
        self.robot = self.folder / "robot"
        identity, code = create_identity(self.robot), self.desk.issue("0BADF00D", "robot")
        first, again = [await register_robot(self.robot, identity, code, self.genesis) for _ in "12"]
        assert (len(first.txid), again.txid, again.member) == (32, b"", first.member), "twice is harmless"
        sealed = (await self.desk.make_roster(identity.identity.public_key)).sealed
        (self.robot / "roster.sealed").write_bytes(sealed)

    async def replay(self, progress: Any = nobody, *, real_time: bool = False) -> RunSummary:
        """Let the robot see the scene once."""
        options = ReplayOptions(
            roster=self.robot / "roster.sealed",
            purpose="demo",
            clip_ms=500,
            events=self.folder / "events.jsonl",
            at_once=not real_time,
            real_time=real_time,
            approver=self.network.approver,
        )
        return await replay_recording(self.robot, BagSource(self.bag), self.genesis, options, progress)

    async def record(self) -> FrameCounts:
        summary = await self.replay()
        await self.told_everywhere()
        return summary.frames


async def refusals(wallet: Wallet, entry: RecordEntry, access_id: bytes) -> set[str]:
    """Return how every custodian answers a request; `RELEASED` if it hands the clip out."""
    key, answers = wallet.owner_key(entry.visit), set()
    for custodian in wallet.network.custody.custodians:
        try:
            await wallet.network.custody.download_clip(custodian, entry.record_id, access_id, key)
        except BlockRobotError as error:
            answers.add(error.code)
        else:
            answers.add("RELEASED")
    return answers


async def settle(wallet: Wallet, entry: RecordEntry, access_id: bytes, expected: str) -> None:
    """Wait until every custodian has followed; each asks at most a few seconds behind the head."""
    deadline_s = time.monotonic() + FINAL_TIMEOUT_S
    while (answers := await refusals(wallet, entry, access_id)) != {expected}:
        assert time.monotonic() < deadline_s, answers
        await asyncio.sleep(0.25)


async def test_what_a_person_says_of_her_visit_is_what_every_custodian_does(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    ward = Ward(network, tmp_path)
    async with ward.wallet("ann") as ann, ward.wallet("officer") as officer:
        await ann.register(ward.desk.issue(UID, "subject"), [])
        await officer.register(ward.desk.issue("0FF1CE", "officer"), [])
        await ConsentClient(ann).give(["demo"], ["depth"])
        await ward.prepare_robot()
        assert (await ward.record()).kept > 0
        rights, viewing = Rights(ann), RecordViewer(ann)
        (report,) = await ann.records()
        entry = report.records[0]

        early = await viewing.request_access([entry], "demo")
        await settle(ann, entry, early, "RELEASED")
        await _restrict_and_correct(ann, rights, viewing, report, early)
        await _deny_and_decide(ann, officer, rights, viewing, report)

        await rights.object_to_recording(["demo"])
        said = await rights.object_to_release(["demo"], at_once=True, on_progress=quiet)
        assert [one.visit.owner for one in said] == [report.visit.owner]
        with pytest.raises(BlockRobotError, match="PURPOSE_OBJECTED"):
            await viewing.request_access([entry], "demo")
        assert (await ward.record()).kept == 0
        assert len(await ann.records()) == 1, "nothing new was recorded"
        word = await ConsentClient(ann).give(["demo"], ["depth"])
        await ward.told_everywhere(word.from_height)
        assert (await ward.record()).kept > 0, "her later word counts, and shows what her objection kept away"
        kinds = [one.kind for one in await audit_all(ann)]
        await _deny_and_erase(ann, officer, rights)
    for kind in ("restricted", "restriction_lifted", "corrected", "denied", "breach_assessed", "breach_closed"):
        assert kinds.count(kind) == 1, kind


async def _restrict_and_correct(
    ann: Wallet, rights: Rights, viewing: RecordViewer, report: VisitReport, early: bytes
) -> None:
    """A request from before is void everywhere, another's purpose is refused, her own look is not."""
    whole, entry = RecordChoice(report.visit), report.records[0]
    await rights.restrict(whole, "legal-claim")
    await settle(ann, entry, early, "ACCESS_ENDED")
    with pytest.raises(BlockRobotError, match="RECORD_RESTRICTED"):
        await viewing.request_access([entry], "demo")
    own = await viewing.request_access([entry], "own-access")
    assert (await viewing.view(entry, own)).verdict == "verified"
    said, correction = await rights.correct(whole, "attribution", "That is my sister.")
    (shown,) = await ann.records()
    assert (shown.rights.corrections_count, shown.rights.restricts(entry.record_id)) == (1, True)
    place = b"rights\x00correction/" + report.visit.owner + bytes(4)
    row = (await ann.values([place], ann.owner_key(report.visit)))[place]
    assert (row["commitment"], row["txid"]) == (commit_correction(correction), said.txid)
    await rights.lift(whole)
    await settle(ann, entry, own, "RELEASED")


async def _deny_and_erase(ann: Wallet, officer: Wallet, rights: Rights) -> None:
    """The second visit ends the other way: every custodian destroys it, by an officer's order."""
    _, report = await ann.records()
    await rights.deny(report.visit)
    handling = Breaches(officer)
    *_, breach = await handling.read_all()
    await handling.assess(breach, "risk", "matched-wrongly")
    await handling.notify(breach, "authority", "")
    assert await handling.close(breach, "erased", "matched-wrongly", quiet) == len(report.records) > 0
    keys = [b"records\x00record/" + entry.record_id for entry in report.records]
    for _ in range(80):
        states = await ann.values(keys, ann.owner_key(report.visit))
        if {state["status"] for state in states.values()} == {"erased"}:
            break
        await asyncio.sleep(0.25)
    assert {state["status"] for state in states.values()} == {"erased"}
    assert (await ann.records())[1].rights.breach_id == breach.breach_id, "what is left stays in quarantine"


async def _deny_and_decide(
    ann: Wallet, officer: Wallet, rights: Rights, viewing: RecordViewer, report: VisitReport
) -> None:
    """Nobody gets a denied visit, she neither; an officer ends that, and no one else can."""
    entry = report.records[0]
    open_request = await viewing.request_access([entry], "own-access")
    await settle(ann, entry, open_request, "RELEASED")
    await rights.deny(report.visit)
    await settle(ann, entry, open_request, "CLIP_QUARANTINED")
    with pytest.raises(BlockRobotError, match="VISIT_QUARANTINED"):
        await viewing.request_access([entry], "own-access")

    handling = Breaches(officer)
    (breach,) = await handling.read_all()
    assert (breach.state.owner, breach.is_open, breach.is_overdue) == (report.visit.owner, True, False)
    assert 71 * 3600 * 1000 < breach.left_ms <= 72 * 3600 * 1000
    with pytest.raises(BlockRobotError, match="NOT_AN_OFFICER"):
        await Breaches(ann).assess(breach, "none", "owner-confirmed")
    await handling.assess(breach, "none", "owner-confirmed")
    assert await handling.close(breach, "released", "owner-confirmed", quiet) == 0
    await settle(ann, entry, open_request, "ACCESS_ENDED")
    again = await viewing.request_access([entry], "own-access")
    assert (await viewing.view(entry, again)).verdict == "verified"
