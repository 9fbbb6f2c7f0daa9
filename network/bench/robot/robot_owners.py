"""Owners' findings: real wallets list, fetch, verify and open recordings in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from clients.wallet.ledger.wallet import VisitReport, Wallet
from clients.wallet.records.viewing import STATUS_NOTICE, STATUS_OK, RecordViewer
from clients.wallet.store.keystore import Keystore
from consensus.chain.genesis import Genesis
from consensus.records.renditions import Rendition

PURPOSE = "own-access"


@dataclass(slots=True)
class OwnFrames:
    """One owner's frame counts per robot (member key); `misplaced_frames` show somebody else's place."""

    frames: dict[bytes, Counter[int]] = field(default_factory=dict)
    record_count: int = 0
    missing_records: int = 0
    unclosed_visits: int = 0
    bad_frames: int = 0
    misplaced_frames: int = 0

    def note(self, robot: bytes, picture: Rendition, *, is_theirs: bool) -> None:
        self.frames.setdefault(robot, Counter())[picture.sequence] += 1
        self.misplaced_frames += not is_theirs


async def find_own_frames(
    wallet_file: Path, passphrase: str, genesis: Genesis, is_theirs: Callable[[Rendition], bool]
) -> OwnFrames:
    """Raises the network's refusals."""
    found = OwnFrames()
    async with Wallet(Keystore.open(wallet_file, passphrase), genesis) as wallet:
        for report in await wallet.records():
            found.record_count += len(report.records)
            found.missing_records += report.missing_count + len(report.unreadable_ids) + len(report.erased_ids)
            found.unclosed_visits += not report.closed
            if report.records:
                await _open_visit(wallet, report, found, is_theirs)
    return found


async def _open_visit(
    wallet: Wallet, report: VisitReport, found: OwnFrames, is_theirs: Callable[[Rendition], bool]
) -> None:
    viewing = RecordViewer(wallet)
    access_id = await wallet.sign_and_wait(report.visit, "access", "request", [[], PURPOSE])
    for entry in report.records:
        view = await viewing.view(entry, access_id)
        for frame in view.frames:
            if frame.status == STATUS_OK and frame.rendition is not None:
                found.note(report.visit.robot, frame.rendition, is_theirs=is_theirs(frame.rendition))
            elif frame.status != STATUS_NOTICE:
                found.bad_frames += 1
