"""A wallet's page with 2,000 records on one day, and what it weighs and takes. Must never be taken for a real history.

The records are copies of one that the wallet has proven, each at a time of its own; only the lists know them.
"""

from __future__ import annotations

import dataclasses
import datetime
import secrets
import zoneinfo
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import msgspec
from playwright.async_api import Page

from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.page.page import ASSETS, make_page
from clients.wallet.page.session import PageSession
from clients.wallet.page.wallet_snapshot import Snapshot, VisitPart
from clients.wallet.store.keystore import KnownVisit
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.weights import weigh

VISITS_COUNT, RECORDS_A_VISIT_COUNT = 25, 80
RECORDS_COUNT = VISITS_COUNT * RECORDS_A_VISIT_COUNT
EVERY_MS = 40_000
ZONE = zoneinfo.ZoneInfo("Europe/Berlin")
KEYS_BYTES = 33


def day_before() -> datetime.date:
    """Return yesterday, where the browser of the tests is."""
    return datetime.datetime.now(ZONE).date() - datetime.timedelta(days=1)


def fill_day(snapshot: Snapshot) -> Snapshot:
    """Return a snapshot with the day before full of copies of one record, in 25 visits."""
    (part, *_) = [part for part in snapshot.visits if part.report.records]
    first = part.report.records[0]
    start = datetime.datetime.combine(day_before(), datetime.time(0, 30), ZONE)
    visits = [_copy_visit(part, first, int(start.timestamp() * 1000), number) for number in range(VISITS_COUNT)]
    every = (*visits, *snapshot.visits)
    entries = {entry.record_id: entry for each in every for entry in each.report.records}
    return dataclasses.replace(snapshot, visits=every, entries=entries)


def _copy_visit(part: VisitPart, entry: RecordEntry, start_ms: int, number: int) -> VisitPart:
    visit: KnownVisit = msgspec.structs.replace(entry.visit, owner=secrets.token_bytes(KEYS_BYTES))
    records = []
    for index in range(RECORDS_A_VISIT_COUNT):
        at_ms = start_ms + (number * RECORDS_A_VISIT_COUNT + index) * EVERY_MS
        times = {"started_at_ms": at_ms, "ended_at_ms": at_ms + 480, "index_in_visit": index}
        metadata = msgspec.structs.replace(entry.metadata, **times)
        records.append(dataclasses.replace(entry, record_id=secrets.token_bytes(16), visit=visit, metadata=metadata))
    report = dataclasses.replace(part.report, visit=visit, records=tuple(records))
    return dataclasses.replace(part, report=report, trail=(), shares=(), erasures=(), verdicts={})


class FullDaySession(PageSession):
    """A session that reads the ledger once, and fills the day before."""

    async def read(self, *, fresh: bool = False) -> None:
        """Read the ledger the first time only."""
        if self.state != "ready":
            await super().read(fresh=fresh)
            self.snapshot = fill_day(self.snapshot)


@asynccontextmanager
async def serve_full_day(network: RecordedNetwork, folder: Path) -> AsyncIterator[Path]:
    """Serve the page of a full day in this process; return the file that opens it."""
    async with network.wallet() as wallet, FullDaySession(wallet, network.profile, folder) as session:
        page = make_page(session)
        try:
            yield (await page.start()).redirect_file
        finally:
            await page.stop()


async def weigh_all_views(page: Page) -> dict[str, float]:
    """Return what the calendar that stands weighs, and what all views weigh together, in bytes; and its first paint."""
    began = await weigh(page)
    for name in sorted(path.name for path in ASSETS.glob("*.js")):
        if name != "app.js":
            await page.evaluate(f"() => import('./{name}')")
    whole = await weigh(page)
    return began | {"all_views_plain_bytes": whole["plain_bytes"], "all_views_sent_bytes": whole["sent_bytes"]}


async def measure_full_day(page: Page) -> dict[str, float]:
    """Open the full day in a page that shows the calendar; return what it took, in milliseconds."""
    took: float = await page.evaluate(
        """async ([day, visits]) => {
        const frame = () => new Promise((done) => requestAnimationFrame(done));
        const began = performance.now();
        location.hash = `#/day/${day}`;
        while (document.querySelectorAll('.visit-row').length < visits) await frame();
        await frame();
        return performance.now() - began; }""",
        [day_before().isoformat(), VISITS_COUNT],
    )
    opened: float = await page.evaluate(
        """async () => {
        const began = performance.now();
        document.querySelector('.visit summary').click();
        const frame = () => new Promise((done) => requestAnimationFrame(done));
        while (!document.querySelector('.record-row')) await frame();
        await frame();
        return performance.now() - began; }"""
    )
    return {
        "day_of_2000_records_ms": round(took, 1),
        "open_a_visit_of_80_ms": round(opened, 1),
    }
