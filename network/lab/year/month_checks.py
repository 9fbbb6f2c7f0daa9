"""What has to hold at the end of each month, between the chain, every custodian and the plan."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterator, Sequence

from consensus.state.access import GRANT_COUNT
from consensus.state.erasure import REQUEST as ERASURE
from consensus.state.identity import CUSTODIANS, MEMBER
from consensus.state.records import ANNOUNCEMENT_COUNT, RECORD
from network.cluster import Cluster
from network.custody.hunt import HuntReport, hunt
from network.custody.traces import Trace, trace_chain, trace_grants, trace_store
from network.lab.year.chain import HospitalChain
from network.lab.year.custody import CustodianPlace, Custodians
from network.lab.year.life import Hospital
from node.storage.ledger_store import LedgerSnapshot

GONE = ("erased", "expired")
SEARCHED_AGAIN_COUNT = 4
"""So many of a month's traces are searched for at the end of later months too; all of them would take hours."""


class Traces:
    """Pieces of some records, taken while they were kept, to search for once they are gone."""

    def __init__(self, chain: HospitalChain, custodians: Custodians) -> None:
        self._chain, self._custodians = chain, custodians
        self.known: dict[bytes, Trace] = {}
        self._again: set[bytes] = set()

    def take(self, record_ids: Sequence[bytes]) -> None:
        with self._chain.store.snapshot() as snapshot:
            for record_id in record_ids:
                trace = self.known.setdefault(record_id, Trace(record_id))
                trace_chain(trace, snapshot)
                for place in self._custodians.places:
                    trace_store(trace, place.config)
                trace.pieces["leaf"] -= trace.pieces["root"]  # of a clip of one frame they are the same

    def gone(self) -> list[Trace]:
        """Those of which nothing may be left by now."""
        with self._chain.store.snapshot() as snapshot:
            for trace in self.known.values():
                trace_chain(trace, snapshot)
                trace_grants(trace, snapshot)
        return [trace for trace in self.known.values() if trace.status in GONE]

    def forget(self, traces: Sequence[Trace]) -> None:
        """All but a few, and those that were searched for again."""
        fresh = [trace for trace in traces if trace.record_id not in self._again]
        self._again.update(trace.record_id for trace in fresh[:SEARCHED_AGAIN_COUNT])
        for trace in fresh[SEARCHED_AGAIN_COUNT:]:
            del self.known[trace.record_id]


def count_records(snapshot: LedgerSnapshot) -> Counter[str]:
    """By status."""
    return Counter(row.status for _, row in RECORD.rows(snapshot))


def _counters(hospital: Hospital, snapshot: LedgerSnapshot) -> Iterator[str]:
    counts = hospital.counts
    found = {
        "announcements": ANNOUNCEMENT_COUNT.read(snapshot) or 0,
        "grants": GRANT_COUNT.read(snapshot) or 0,
        "members": sum(row.is_active for _, row in MEMBER.rows(snapshot)),
        "records": count_records(snapshot).total(),
        "erasure requests": sum(1 for _ in ERASURE.rows(snapshot)),
    }
    people = (hospital.members, hospital.doctors, hospital.robots, [hospital.officer])
    wanted = {
        "announcements": counts["visits"] + counts["visits moved to new keys"],
        "grants": counts["shares"],
        "members": sum(map(len, people)),
        "records": counts["records"],
        "erasure requests": counts["erasures asked for"],
    }
    for what, count in wanted.items():
        if found[what] != count:
            yield f"the chain has {found[what]} {what}, and {count} were made"


def _erasures(snapshot: LedgerSnapshot) -> Iterator[str]:
    custodians = set(CUSTODIANS.read(snapshot) or [])
    for (erasure_id,), row in ERASURE.rows(snapshot):
        if row.status != "complete" or set(row.receipts) != custodians:
            yield f"erasure {erasure_id.hex()} has {len(row.receipts)} of {len(custodians)} receipts"
    for (record_id,), record in RECORD.rows(snapshot):
        if record.status in {"erasing", "expired"}:
            yield f"record {record_id.hex()} is still {record.status}"


async def _custodian(place: CustodianPlace, chain: HospitalChain, kept: int) -> list[str]:
    """The scrub compares every record; the counts find what it does not look at."""
    report, counts = await place.scrub(chain.store), await place.store.counts()
    troubles = []
    if not report.is_clean:
        troubles.append(f"the scrub of {place.name} is not clean: {report}")
    wanted = {"confirmed": kept, "staged": 0, "missing": 0, "outbox_ready": 0, "outbox_erasing": 0}
    found = {name: getattr(counts, name) for name in wanted}
    if found != wanted:
        troubles.append(f"{place.name} has {found} and not {wanted}")
    if place.keys.held_count != counts.frames + counts.parts:
        troubles.append(
            f"{place.name} holds {place.keys.held_count} keys for {counts.frames} frames and {counts.parts} parts"
        )
    return troubles


async def search_remains(cluster: Cluster, traces: Traces) -> tuple[HuntReport, list[str]]:
    """Of records that are gone since the last search, and some of those before."""
    report = await asyncio.to_thread(hunt, cluster, traces.gone())
    traces.forget(report.traces)
    found = [f"{each.what} of {each.record_id.hex()} is left in {each.place}" for each in report.forbidden]
    found += [f"not searched: {each}" for each in report.unread]
    return report, found + [f"{each.record_id.hex()} could not be compared" for each in report.not_compared]


async def check_month(hospital: Hospital, chain: HospitalChain, custodians: Custodians) -> list[str]:
    with chain.store.snapshot() as snapshot:
        troubles = [*_counters(hospital, snapshot), *_erasures(snapshot)]
        kept = count_records(snapshot)["active"]
    for place in custodians.places:
        troubles += await _custodian(place, chain, kept)
    return troubles
