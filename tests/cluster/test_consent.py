"""A person, her wallet and a robot on real nodes: she consents, is recorded, takes it back while it runs, and is not."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from clients.registrar.desk import Desk
from clients.robot.identity.robot_enrolment import register_robot
from clients.robot.identity.robot_keys import create_identity
from clients.robot.run.run_summary import RunProgress
from clients.robot.run.runner import ReplayOptions, replay_recording
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.scenario import parse_scenario
from clients.robot.synthetic.scenario_bag import make_bag
from clients.wallet.consent.consent_choices import Consenting
from clients.wallet.ledger.wallet import VisitReport, Wallet
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import draw_words
from tests.cluster.network_under_test import NetworkUnderTest
from tests.unit.clients.wallet.conftest import CHEAP
from tests.walking_alone import UID, walking_alone

SECONDS = 12.0
RATE = 4
PACE = walking_alone(
    "pace",
    SECONDS,
    [(0.0, -0.5, 2.5), (6.0, 0.5, 2.0), (SECONDS, -0.5, 2.5)],
    [round(0.1 + 0.4 * number, 1) for number in range(29)],
    frame_rate=RATE,
)


class _Progress:
    """Lets her take it back once something of her is recorded."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet
        self.withdrawing: asyncio.Task[Any] | None = None

    def __call__(self, figures: RunProgress, *, last: bool = False) -> None:
        if self.withdrawing is None and (figures.frames_recorded or 0) > 0:
            self.withdrawing = asyncio.create_task(Consenting(self._wallet).withdraw([], []))


def _frame_count(reports: list[VisitReport]) -> int:
    return sum(
        entry.metadata.frame_count for report in reports for entry in report.records if entry.metadata.sensor == "depth"
    )


@pytest.mark.smoke
async def test_what_is_taken_back_while_the_robot_runs_is_recorded_no_more(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    bag = await asyncio.to_thread(make_bag, parse_scenario(PACE), {"ann": UID}, tmp_path / "bags", workers=1)
    genesis = network.genesis
    desk = Desk(network.folder / "organisations" / genesis.organisations[0].name, genesis)
    async with Wallet(Keystore.create(tmp_path / "ann.wallet", draw_words(), "tea", CHEAP), genesis) as wallet:
        await wallet.register(desk.issue(UID, "subject"), [])
        await Consenting(wallet).give(["demo"], ["depth"])
        folder = tmp_path / "robot"
        identity = create_identity(folder)
        code = desk.issue("0BADF00D", "robot")
        first, again = [await register_robot(folder, identity, code, genesis) for _ in "12"]
        assert (len(first.txid), again.txid, again.member) == (32, b"", first.member), "twice is harmless"
        sealed, rows = await desk.make_roster(identity.identity.public_key)
        (folder / "roster.sealed").write_bytes(sealed)
        options = ReplayOptions(
            roster=folder / "roster.sealed",
            purpose="demo",
            clip_ms=500,
            events=folder / "events.jsonl",
            at_once=False,
            real_time=True,
            approver=network.approver,
        )
        progress = _Progress(wallet)
        summary = await replay_recording(folder, BagSource(bag), genesis, options, progress)
        assert progress.withdrawing is not None
        word = await progress.withdrawing
        (choice,) = (await Consenting(wallet).choices()).rows
        reports = await wallet.records()
        idle = await Consenting(wallet).withdraw([], [])
        anew = await Consenting(wallet).give(["demo"], ["depth"])

    frames = summary.frames
    assert rows == summary.roster_rows == 1
    assert (frames.published, frames.lost) == (RATE * SECONDS, 0)
    assert 0 < frames.kept < frames.covered
    assert frames.withheld_reasons["no-consent"] > 0
    assert (choice.holds, choice.last.status, choice.last.height) == (False, "withdrawn", word.from_height)
    assert _frame_count(reports) == frames.kept
    assert (idle.count, anew.count) == (0, 1), "who has seen her own no final gives again at once"
    taken_ms = [entry.metadata.ended_at_ms for report in reports for entry in report.records]
    assert taken_ms
    assert max(taken_ms) < choice.last.since_ms, "nothing of her was taken at or after the moment of her word"
    assert list((folder / "spool").iterdir()) == []
