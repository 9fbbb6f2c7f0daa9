"""A person, her wallet and a robot on real nodes: she consents, is recorded, takes it back while it runs, and is not."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from clients.robot.run.run_summary import RunProgress
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.wallet import VisitReport, Wallet
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.test_rights import Ward
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
            self.withdrawing = asyncio.create_task(ConsentClient(self._wallet).withdraw([], []))


def _frame_count(reports: list[VisitReport]) -> int:
    return sum(
        entry.metadata.frame_count for report in reports for entry in report.records if entry.metadata.sensor == "depth"
    )


@pytest.mark.smoke
async def test_what_is_taken_back_while_the_robot_runs_is_recorded_no_more(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    ward = Ward(network, tmp_path)
    async with ward.wallet("ann") as wallet:
        await wallet.register(ward.desk.issue(UID, "subject"), [])
        await ConsentClient(wallet).give(["demo"], ["depth"])
        await ward.prepare_robot(PACE)
        progress = _Progress(wallet)
        summary = await ward.replay(progress, real_time=True)
        assert progress.withdrawing is not None
        word = await progress.withdrawing
        (choice,) = (await ConsentClient(wallet).choices()).rows
        reports = await wallet.records()
        idle = await ConsentClient(wallet).withdraw([], [])
        anew = await ConsentClient(wallet).give(["demo"], ["depth"])

    frames = summary.frames
    assert summary.roster_rows == 1
    assert (frames.published, frames.lost) == (RATE * SECONDS, 0)
    assert 0 < frames.kept < frames.covered
    assert frames.withheld_reasons["no-consent"] > 0
    assert (choice.holds, choice.last.status, choice.last.height) == (False, "withdrawn", word.from_height)
    assert _frame_count(reports) == frames.kept
    assert (idle.count, anew.count) == (0, 1), "who has seen her own no final gives again at once"
    taken_ms = [entry.metadata.ended_at_ms for report in reports for entry in report.records]
    assert taken_ms
    assert max(taken_ms) < choice.last.since_ms, "nothing of her was taken at or after the moment of her word"
    assert list((ward.robot / "spool").iterdir()) == []
