"""Plays a hospital's days one after the other, and checks what has to hold at the end of each month and of all."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from consensus.chain.block import Receipt
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.limits import DAY_MS
from consensus.state.identity import MEMBER
from network.bench.conditions import measure_conditions
from network.cluster import Cluster
from network.custody.hunt import HuntReport
from network.lab.year.chain import HospitalChain, Spent, found_network, make_hospital_chain
from network.lab.year.custody import Custodians, open_place
from network.lab.year.end_checks import (
    audit_members,
    keep_backup,
    keep_snapshot,
    restore_backup,
    size_of,
    start_from_snapshot,
)
from network.lab.year.figures import COSTS, HospitalYearAnswer, YearEnd, YearMonth
from network.lab.year.life import Hospital, Story
from network.lab.year.month_checks import Traces, check_month, count_records, search_remains
from network.lab.year.out_folder import BACKUP, NETWORK, REPORT_FILE, RESTORED, SNAPSHOT
from network.lab.year.plan import HospitalPlan, YearOptions
from network.sim.world.sim_chain import EPOCH_MS
from network.sim.world.sim_cluster import quiet_logs
from node.storage.lmdb_store import DATA_FILE_NAME

MONTH_DAYS = 30
HOUR_MS = 3_600_000
FIRST_HOUR = 8
TRACED_ERASURES_A_DAY = 2
TROUBLES_MAX_COUNT = 100
_SETTLING_BLOCKS_MAX_COUNT = 1_000
_ROWS_COUNT = 1 << 60
OnProgress = Callable[[str], None]


class YearRun:
    """One hospital's run: chain, custodians, people and the plan."""

    def __init__(self, options: YearOptions, out: Path, on_progress: OnProgress) -> None:
        self.options, self.out, self._on_progress = options, out, on_progress
        self.spent = Spent()
        self.plan = HospitalPlan(options)
        self.months: list[YearMonth] = []
        self.troubles: list[str] = []
        self.played_s = self.played_cpu_s = 0.0
        self.hunted: list[HuntReport] = []
        self.chain: HospitalChain
        self.custodians: Custodians
        self.hospital: Hospital
        self.traces: Traces
        self._traced_today = 0

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        options, network = self.options, self.out / NETWORK
        chain = make_hospital_chain(options.custodians)
        configs = found_network(network, chain)
        self.cluster = Cluster(network)
        self.chain = HospitalChain(chain, configs[0].ledger_dir, options.seed, self.spent)
        await self.chain.create()
        async with AsyncExitStack() as stack:
            places = []
            for config, key in zip(configs, chain.custodians, strict=True):
                assert key is not None, "each node of the hospital is a custodian"
                places.append(await stack.enter_async_context(open_place(config, key, lambda: self.chain.now_ms)))
            self.custodians = Custodians(self.chain, self.spent, places)
            self._on_progress(f"making the keys of {options.members} members")
            self.hospital = Hospital(options, self.chain, self.custodians)
            self.hospital.troubles = self.troubles
            self.hospital.erase_soon = self._trace_erased
            self.traces = Traces(self.chain, self.custodians)
            try:
                yield
            finally:
                await self.chain.close()

    def _trace_erased(self, record_ids: list[bytes]) -> None:
        if self._traced_today < TRACED_ERASURES_A_DAY:
            self._traced_today += 1
            self.traces.take(record_ids[:1])

    # Blocks

    async def play(self, stories: Sequence[Story], calls: Sequence[Transaction] = ()) -> None:
        """A block at least; as many as it takes until nobody has anything left to say."""
        receipts: dict[bytes, Receipt] = {}
        waiting = [(story, await self._go_on(story, [], receipts)) for story in stories]
        for number in range(_SETTLING_BLOCKS_MAX_COUNT):
            owed = await self.custodians.owed()
            pending = [*calls, *(call for _, own in waiting for call in own)]
            batch = [call for call, _, _ in owed.values()]
            batch += [call for call in pending if call.txid not in receipts]
            if number and not batch:
                return
            made = await self.chain.block(batch)
            await self.custodians.follow(made.events)
            if batch and not made.receipts:
                break
            receipts |= made.receipts
            for txid, receipt in made.receipts.items():
                if not receipt.ok:
                    self.troubles.append(f"a call was refused: {receipt.code}, {receipt.message}")
                    if txid in owed:
                        await owed[txid][1].custodian.dismiss(owed[txid][2])
            waiting = [(story, await self._go_on(story, own, receipts)) for story, own in waiting]
            waiting = [(story, own) for story, own in waiting if own]
        first = batch[0].body
        self.troubles.append(
            f"{number + 1} blocks bring it to no end: of {len(batch)} calls for the last one the first is "
            f"{first.contract}.{first.entry}, and it took {len(made.receipts)}"
        )

    async def _go_on(self, story: Story, calls: list[Transaction], receipts: dict[bytes, Receipt]) -> list[Transaction]:
        """The next calls of a story once all of its last ones are in blocks; none at its end, or after a refusal."""
        if not all(call.txid in receipts for call in calls):
            return calls
        found = [receipts[call.txid] for call in calls]
        try:
            if all(receipt.ok for receipt in found):
                return await (story.asend(found) if found else anext(story))
        except StopAsyncIteration:
            return []
        except BlockRobotError as error:
            self.troubles.append(f"a custodian refused: {error}")
        except LookupError as error:  # a visit or a grant that was refused on another day
            self.troubles.append(f"{getattr(story, '__name__', 'a story')} of what is not there: {error!r}")
        await story.aclose()
        return []

    async def play_day(self) -> None:
        started_s, started_cpu_s = time.perf_counter(), time.process_time()
        self._traced_today, self.hospital.recorded_today = 0, []
        events = self.plan.next_day()
        by_slot: dict[int, list[Story]] = defaultdict(list)
        for event in events:
            by_slot[event.slot].append(self.hospital.tell(event))
        for slot in sorted({0, *by_slot}):
            self.chain.maker.at_ms = EPOCH_MS + (self.plan.day + 1) * DAY_MS + (FIRST_HOUR + slot) * HOUR_MS
            await self.play(by_slot[slot])
        self.traces.take(self.hospital.recorded_today[:1])
        self.played_s += time.perf_counter() - started_s
        self.played_cpu_s += time.process_time() - started_cpu_s

    async def begin(self) -> None:
        self.chain.maker.at_ms = EPOCH_MS + FIRST_HOUR * HOUR_MS
        await self.play([], self.hospital.registrations())

    # Ends of months

    async def end_month(self, days: int) -> None:
        """`days`: of this month."""
        seconds = {what: round(self.spent.seconds[what] / days, 3) for what in COSTS}
        started_s = time.perf_counter()
        self.troubles += await check_month(self.hospital, self.chain, self.custodians)
        report, found = await search_remains(self.cluster, self.traces)
        self.troubles += found
        self.hunted.append(report)
        checks_s = time.perf_counter() - started_s
        config, counts = self.custodians.places[0].config, self.hospital.counts
        with self.chain.store.snapshot() as snapshot:
            by_status = count_records(snapshot)
            month = YearMonth(
                days=self.plan.day + 1,
                blocks=self.chain.height + 1,
                transactions=self.chain.transactions_count,
                members=sum(row.is_active for _, row in MEMBER.rows(snapshot)),
                visits=counts["visits"],
                records=by_status.total(),
                kept=by_status["active"],
                erased=by_status.total() - by_status["active"],
                state_entries=sum(1 for _ in snapshot.scan(b"", _ROWS_COUNT)),
                ledger_bytes=512 * (config.ledger_dir / DATA_FILE_NAME).stat().st_blocks,
                custody_bytes=size_of(config.custody_dir),
                erase_key_bytes=size_of(config.erase_keys_dir),
                erase_keys=self.custodians.places[0].keys.held_count,
                seconds_a_day=seconds,
                day_s=round(self.played_s / days, 3),
                day_cpu_s=round(self.played_cpu_s / days, 3),
                checks_s=round(checks_s, 1),
            )
        self.months.append(month)
        self.spent.seconds.clear()
        self.played_s = self.played_cpu_s = 0.0

    async def keep_copies(self) -> None:
        """Before the last day, so that there is something to catch up with."""
        keep_snapshot(self.chain, self.out / SNAPSHOT)
        await self.chain.close()
        keep_backup(self.custodians.places[0].config, self.out / BACKUP)
        self.chain.open()

    async def end(self) -> YearEnd:
        self._on_progress("audits of members")
        audits = await audit_members(self.hospital, self.chain, self.options.seed)
        self._on_progress("a node from a snapshot")
        begun = await start_from_snapshot(self.chain, self.out / SNAPSHOT, self.out / RESTORED)
        self._on_progress("a node from a backup")
        first = self.custodians.places[0]
        restored = await restore_backup(self.chain, self.custodians, self.out / BACKUP, self.out / RESTORED, first.key)
        self.troubles += [*audits.troubles, *begun.troubles, *restored.troubles]
        return YearEnd(
            audits=audits.members,
            audit_entries=audits.entries,
            audit_s=round(audits.seconds / audits.members, 2),
            hunted_records=sum(len(report.traces) for report in self.hunted),
            hunted_bytes=sum(report.size_bytes for report in self.hunted),
            snapshot_bytes=begun.size_bytes,
            snapshot_start_s=round(begun.seconds, 1),
            backup_bytes=restored.size_bytes,
            restore_s=round(restored.seconds, 1),
            clips_fetched=restored.clips_fetched,
        )


async def run_year(options: YearOptions, out: Path, on_progress: OnProgress = lambda _text: None) -> HospitalYearAnswer:
    """`out`: a folder that is new or empty. What did not go as it should is in `failures`."""
    conditions = measure_conditions(nodes=options.custodians, **options._asdict())
    run = YearRun(options, out, on_progress)
    total_s = 0.0
    with quiet_logs():
        async with run.opened():
            await run.begin()
            for day in range(1, options.days + 1):
                if day == options.days:
                    await run.keep_copies()
                before_s = run.played_s
                await run.play_day()
                total_s += run.played_s - before_s
                on_progress(f"day {day} of {options.days}: block {run.chain.height}, {total_s:.0f} s")
                if day % MONTH_DAYS == 0 or day == options.days:
                    on_progress(f"checks after day {day}")
                    await run.end_month((day - 1) % MONTH_DAYS + 1)
            end = await run.end()
            head = run.chain.store.position
    assert head is not None, "the hospital's chain has blocks"
    return HospitalYearAnswer(
        failures=run.troubles[:TROUBLES_MAX_COUNT],
        seed=options.seed,
        head=head.block_id.hex(),
        happened=dict(sorted(run.hospital.counts.items())),
        months=run.months,
        end=end,
        days_a_minute=round(60 * options.days / total_s, 1) if total_s else 0.0,
        report=str(out / REPORT_FILE),
        conditions=dict(conditions),
    )
