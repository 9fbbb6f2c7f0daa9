"""Delivery, in virtual time: over cuts, refusals and kills, every clip reaches the chain once, or somebody hears of it."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from structlog.testing import capture_logs

from clients.robot.delivery.delivery import (
    CLIPS_LOADED_MAX_COUNT,
    DELIVERIES_AT_ONCE_MAX_COUNT,
    OVERDUE_AFTER_MS,
    RETRY_MAX_MS,
    RETRY_TOLD_EVERY_MS,
    SUBMIT_DELAY_MAX_MS,
    Delivery,
    Whose,
)
from clients.robot.recording.spool import Delivered, Spool, SpooledClip
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipUpload
from tests.unit.clients.robot.test_spool import KEY, clip
from tests.virtual_time import in_virtual_time, run_virtual, virtual_now_ms

pytestmark = pytest.mark.usefixtures("inline_threads")

ROBOT = PrivateKey(bytes([5] * 32))
LATENCY_MS = 40


@dataclass(frozen=True, slots=True)
class Receipt:
    ok: bool
    code: str


class FakeNetwork:
    """A chain of visits and records with two custodians behind it, which can be cut off or told to refuse."""

    def __init__(self) -> None:
        self.visits: dict[bytes, list[Any]] = {}
        self.closed: dict[bytes, int] = {}
        self.records: dict[bytes, bytes] = {}
        self.uploads: dict[bytes, ClipUpload] = {}
        self.calls: list[tuple[int, str]] = []
        self.refusals: list[str] = []
        self.close_refusals: list[str] = []
        self.upload_refusals: list[str] = []
        self.others_visits: set[bytes] = set()
        self.others_records: set[bytes] = set()
        self.verdict: str = ""
        self.verdicts: dict[str, str] = {}
        self.answers_lost_count = 0
        self.question_refusals: list[str] = []
        self.asked_visits: list[bytes] = []
        self.on_upload: Callable[[ClipUpload], None] = lambda _: None
        self.at_once_count = 0
        self.at_once_max_count = 0
        self._salt = 0

    def now_ms(self) -> int:
        return virtual_now_ms()

    def sign(self, contract: str, entry: str, arguments: list[Any]) -> Transaction:
        self._salt += 1
        return sign_transaction(
            ROBOT,
            chain_id=bytes(32),
            contract=contract,
            entry=entry,
            arguments=arguments,
            valid_until_ms=self.now_ms() + 120_000,
            salt=self._salt.to_bytes(8, "big"),
        )

    async def upload(self, upload: ClipUpload) -> None:
        await asyncio.sleep(0.005)
        if self.upload_refusals:
            raise BlockRobotError(self.upload_refusals.pop(0))
        self.uploads[upload.record_id] = upload
        self.on_upload(upload)

    async def robot_of_visit(self, owner: bytes) -> Whose:
        if self.question_refusals:
            raise BlockRobotError(self.question_refusals.pop(0))
        self.asked_visits.append(owner)
        if owner in self.others_visits:
            return "another"
        return "this" if owner in self.visits else "none"

    async def robot_of_record(self, record_id: bytes) -> Whose:
        if self.question_refusals:
            raise BlockRobotError(self.question_refusals.pop(0))
        if record_id in self.others_records:
            return "another"
        return "this" if record_id in self.records else "none"

    async def submit_and_wait(self, transaction: Transaction) -> Receipt:
        self.calls.append((self.now_ms(), transaction.body.entry))
        self.at_once_count += 1
        self.at_once_max_count = max(self.at_once_max_count, self.at_once_count)
        await asyncio.sleep(LATENCY_MS / 1000)
        self.at_once_count -= 1
        if self.refusals:
            raise BlockRobotError(self.refusals.pop(0))
        if self.close_refusals and transaction.body.entry == "close_visit":
            raise BlockRobotError(self.close_refusals.pop(0))
        code = self.verdict or self.verdicts.get(transaction.body.entry) or self._execute(transaction)
        if self.answers_lost_count:
            self.answers_lost_count -= 1
            raise BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME")
        return Receipt(ok=code == "OK", code=code)

    def _execute(self, transaction: Transaction) -> str:
        arguments = transaction.arguments()
        if transaction.body.entry == "open_visit":
            if arguments[0] in self.visits or arguments[0] in self.others_visits:
                return "VISIT_EXISTS"
            self.visits[arguments[0]] = arguments
        elif transaction.body.entry == "close_visit":
            if arguments[0] in self.closed:
                return "VISIT_CLOSED"
            if arguments[0] not in self.visits:
                return "VISIT_UNKNOWN"
            self.closed[arguments[0]] = arguments[1]
        else:
            record_id, owner = arguments[0], arguments[1]
            if owner not in self.visits:
                return "VISIT_UNKNOWN"
            if owner in self.closed:
                return "VISIT_CLOSED"
            if record_id in self.records or record_id in self.others_records:
                return "RECORD_EXISTS"
            assert self.uploads[record_id].txid, "a record is submitted only after its upload"
            self.records[record_id] = owner
        return "OK"

    def times(self, entry: str) -> list[int]:
        return [at_ms for at_ms, called in self.calls if called == entry]


class Run:
    """A spool with clips, a network, and what was delivered."""

    def __init__(self, folder: Path, clips: int = 1) -> None:
        self.network = FakeNetwork()
        self.spool = Spool(folder, KEY)
        self.names = [self.spool.put(clip(number)) for number in range(clips)]
        self.done: list[Delivered] = []
        self.dropped: list[SpooledClip] = []
        self.refused: set[bytes] = set()
        self.asked = 0

    async def may_record_clip(self, clip: SpooledClip) -> bool:
        self.asked += 1
        return clip.upload.record_id not in self.refused

    async def note_dropped(self, clip: SpooledClip) -> None:
        self.dropped.append(clip)

    def delivery(self, *, at_once: bool = True) -> Delivery:
        return Delivery(
            self.spool,
            self.network,
            on_delivered=self.done.append,
            may_record_clip=self.may_record_clip,
            on_dropped=self.note_dropped,
            at_once=at_once,
        )

    async def deliver_all(self, *, at_once: bool = True) -> Delivery:
        delivery = self.delivery(at_once=at_once)
        try:
            for name in self.spool.names():
                delivery.start(name)
            await delivery.drain()
        finally:
            await delivery.stop()
        return delivery


def refused(main: Coroutine[Any, Any, object]) -> BlockRobotError:
    with pytest.raises(BlockRobotError) as caught:
        run_virtual(main)
    return caught.value


def test_a_visit_is_announced_once_and_before_its_records(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=5)
    run_virtual(run.deliver_all())
    assert len(run.network.times("open_visit")) == 1
    assert min(run.network.times("record")) >= run.network.times("open_visit")[0] + LATENCY_MS
    assert len(run.network.records) == 5


def test_a_delivered_clip_leaves_the_spool_and_is_reported_once(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=3)
    run_virtual(run.deliver_all())
    assert run.spool.names() == []
    assert sorted(done.clip.upload.record_id for done in run.done) == sorted(run.network.records)
    assert all(done.final_at_ms - done.submitted_at_ms == LATENCY_MS for done in run.done)


def test_an_upload_names_the_transaction_that_it_goes_with(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run_virtual(run.deliver_all())
    (upload,) = run.network.uploads.values()
    assert upload.txid == run.done[0].txid
    assert upload.valid_until_ms > run.done[0].final_at_ms


@pytest.mark.parametrize(
    "code", ["NODE_UNREACHABLE", "MEMPOOL_FULL", "SENDER_LIMIT", "NODE_NOT_READY", "TRANSACTION_EXPIRED", "INTERNAL"]
)
def test_what_may_pass_is_tried_again(tmp_path: Path, code: str) -> None:
    run = Run(tmp_path)
    run.network.refusals = [code] * 4
    run.network.upload_refusals = ["STORE_UNAVAILABLE"]
    run_virtual(run.deliver_all())
    assert len(run.network.records) == 1
    assert run.spool.names() == []


def test_a_cut_of_ten_minutes_loses_nothing_and_is_not_hammered_at(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=2)

    async def main() -> int:
        started_ms = virtual_now_ms()
        run.network.refusals = ["NODE_UNREACHABLE"] * 120
        await run.deliver_all()
        return virtual_now_ms() - started_ms

    lasted_ms = run_virtual(main())
    assert lasted_ms > 10 * 60 * 1000 * 0.9
    assert len(run.network.records) == 2
    opened = run.network.times("open_visit")
    gaps = [later - earlier for earlier, later in itertools.pairwise(opened)]
    assert gaps == sorted(gaps)
    assert max(gaps) <= RETRY_MAX_MS + LATENCY_MS


@in_virtual_time
async def test_a_record_whose_answer_was_lost_is_there_once(tmp_path: Path) -> None:
    """The chain took it, the robot did not hear: the second attempt is refused as RECORD_EXISTS, and that is success."""
    run = Run(tmp_path)
    delivery = run.delivery()
    await delivery.announce(run.spool.get(run.names[0]))
    run.network.answers_lost_count = 1
    delivery.start(run.names[0])
    await delivery.drain()
    assert len(run.network.times("record")) == 2
    assert len(run.network.records) == 1
    assert (len(run.done), run.spool.names()) == (1, [])


@pytest.mark.parametrize("code", ["NOT_A_ROBOT", "VISIT_CLOSED", "METADATA_WRONG"])
def test_what_the_contract_refuses_stops_the_run_and_keeps_the_clip(tmp_path: Path, code: str) -> None:
    run = Run(tmp_path)
    run.network.verdict = code
    error = refused(run.deliver_all())
    assert error.code == "NOT_PERMITTED"
    assert code in error.detail
    assert run.spool.names() == run.names
    assert run.done == []


@pytest.mark.parametrize("code", ["SENDER_NOT_ADMITTED", "SIGNATURE_INVALID", "UPLOAD_INVALID"])
def test_what_can_never_pass_is_not_tried_again(tmp_path: Path, code: str) -> None:
    run = Run(tmp_path)
    run.network.upload_refusals = [code]
    assert refused(run.deliver_all()).code == code
    assert run.network.times("record") == []
    assert run.spool.names() == run.names


def test_one_bad_clip_does_not_keep_the_others_from_the_chain(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=4)
    path = tmp_path / run.names[1]
    sealed = path.read_bytes()
    path.write_bytes(sealed[:-1] + bytes([sealed[-1] ^ 1]))
    assert refused(run.deliver_all()).code == "SPOOL_DAMAGED"
    assert len(run.network.records) == 3
    assert run.spool.names() == [run.names[1]]


def test_a_clip_that_its_owner_erased_meanwhile_is_let_go(tmp_path: Path) -> None:
    """Killed after the record was final but before the clip left the spool: custodians say that it is erased."""
    run = Run(tmp_path)
    stored = run.spool.get(run.names[0])
    run.network.records[stored.upload.record_id] = stored.owner
    run.network.upload_refusals = ["CLIP_ERASED"]
    run.network.question_refusals = ["NODE_UNREACHABLE"]
    run.network.upload_refusals.append("CLIP_ERASED")
    delivery = run_virtual(run.deliver_all())
    assert run.spool.names() == []
    assert run.network.times("record") == []
    assert delivery.dropped_count == 0


def with_fresh_clip(folder: Path, age_ms: int = 0) -> Run:
    run = Run(folder)
    run.spool.remove(run.names[0])
    bucket_ms = 1_800_000_900_000 - age_ms
    fresh = {"bucket_ms": bucket_ms, "visit_bucket_ms": bucket_ms, "expires_at_ms": 1_900_000_000_000}
    run.names = [run.spool.put(msgspec.structs.replace(clip(), **fresh))]
    return run


@pytest.mark.parametrize("code", ["CLIP_ERASED", "UPLOAD_CONFLICT"])
def test_what_a_custodian_says_of_a_clip_is_believed_only_if_the_chain_proves_it(tmp_path: Path, code: str) -> None:
    run = with_fresh_clip(tmp_path)
    run.network.upload_refusals = [code] * 3
    delivery = run_virtual(run.deliver_all())
    assert (len(run.network.records), len(run.done), delivery.dropped_count, run.spool.names()) == (1, 1, 0, [])


@pytest.mark.parametrize("code", ["CLIP_ERASED", "UPLOAD_CONFLICT"])
def test_an_id_that_is_kept_from_a_robot_for_a_day_ends_with_a_gap_that_is_counted(tmp_path: Path, code: str) -> None:
    run = with_fresh_clip(tmp_path, OVERDUE_AFTER_MS - 60_000)
    run.network.upload_refusals = [code] * 10_000
    delivery = run_virtual(run.deliver_all())
    assert (run.network.records, run.done, delivery.dropped_count, run.spool.names()) == ({}, [], 1, [])


@pytest.mark.parametrize("refused_by", ["the chain", "a custodian"])
def test_a_record_of_this_id_that_another_robot_made_is_no_delivery(tmp_path: Path, refused_by: str) -> None:
    run = Run(tmp_path, clips=2)
    run.network.others_records = {run.spool.get(run.names[0]).upload.record_id}
    if refused_by == "a custodian":
        run.network.upload_refusals = ["UPLOAD_CONFLICT"]
    delivery = run_virtual(run.deliver_all())
    assert (len(run.network.records), len(run.done), delivery.dropped_count, run.spool.names()) == (1, 1, 1, [])


def test_a_record_that_no_node_proves_yet_is_asked_for_again(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.network.answers_lost_count = 1
    found, asked = run.network.robot_of_record, list[bytes]()

    async def behind(record_id: bytes) -> Whose:
        asked.append(record_id)
        return "none" if len(asked) == 1 else await found(record_id)

    run.network.robot_of_record = behind  # type: ignore[method-assign]
    delivery = run.delivery()
    run.network.records[run.spool.get(run.names[0]).upload.record_id] = run.spool.get(run.names[0]).owner
    run_virtual(run.deliver_all())
    assert len(asked) == 2
    assert (len(run.done), delivery.dropped_count, run.spool.names()) == (1, 0, [])


def test_a_robot_killed_at_any_moment_delivers_everything_once(tmp_path: Path) -> None:
    """Stop after every few milliseconds of a delivery, begin again with a new process's view of the spool."""
    for killed_after_ms in range(0, 220, 9):
        folder = tmp_path / str(killed_after_ms)
        run = Run(folder, clips=3)

        async def first_life(run: Run = run, lives_ms: int = killed_after_ms) -> None:
            delivery = run.delivery()
            for name in run.names:
                delivery.start(name)
            await asyncio.sleep(lives_ms / 1000)
            await delivery.stop()

        run_virtual(first_life())
        run.spool = Spool(folder, KEY)
        run_virtual(run.deliver_all())
        assert len(run.network.records) == 3, killed_after_ms
        assert run.spool.names() == []


@in_virtual_time
async def test_what_waits_is_told_once_in_a_while_with_how_much_waits(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=5)
    run.network.upload_refusals = ["STORE_UNAVAILABLE"] * 10_000
    delivery = run.delivery()
    with capture_logs() as told:
        for name in run.names:
            delivery.start(name)
        await asyncio.sleep(3.5 * RETRY_TOLD_EVERY_MS / 1000)
        await delivery.stop()
    assert 3 <= len(told) <= 5
    assert {(line["code"], line["clips_waiting"]) for line in told} == {("STORE_UNAVAILABLE", 5)}


@in_virtual_time
async def test_stopping_leaves_what_is_not_final_in_the_spool(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=2)
    run.network.refusals = ["NODE_UNREACHABLE"] * 10_000
    delivery = run.delivery()
    for name in run.names:
        delivery.start(name)
    await asyncio.sleep(60)
    await delivery.stop()
    assert run.spool.names() == run.names
    assert run.done == []


def test_owners_of_one_scene_are_not_submitted_side_by_side(tmp_path: Path) -> None:
    """Each record goes after a random delay of up to half a second, unless the user asked otherwise."""
    run = Run(tmp_path, clips=8)
    run_virtual(run.deliver_all(at_once=False))
    times = run.network.times("record")
    assert len(set(times)) > 4
    assert max(times) - min(times) <= SUBMIT_DELAY_MAX_MS + 1


def test_only_so_many_are_under_way_at_once(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=3 * DELIVERIES_AT_ONCE_MAX_COUNT)
    run_virtual(run.deliver_all())
    assert run.network.at_once_max_count == DELIVERIES_AT_ONCE_MAX_COUNT


@in_virtual_time
async def test_a_spool_that_filled_up_over_days_is_not_held_in_memory(tmp_path: Path) -> None:
    """Clips wait for the registry one after another; only so many are read beforehand."""
    run = Run(tmp_path, clips=3 * CLIPS_LOADED_MAX_COUNT)
    loaded: list[str] = []
    get = run.spool.get
    run.spool.get = lambda name: loaded.append(name) or get(name)  # type: ignore[method-assign,func-returns-value]
    heard = asyncio.Event()

    async def may_record_clip(_: SpooledClip) -> bool:
        await heard.wait()
        return True

    run.may_record_clip = may_record_clip  # type: ignore[method-assign]
    delivery = run.delivery()
    for name in run.names:
        delivery.start(name)
    await asyncio.sleep(60)
    assert loaded == run.names[:CLIPS_LOADED_MAX_COUNT]
    heard.set()
    await delivery.drain()
    await delivery.stop()
    assert (len(run.network.records), run.spool.names()) == (len(run.names), [])


@pytest.mark.parametrize("code", ["BUCKET_WRONG", "EXPIRY_WRONG"])
def test_a_clip_that_waited_too_long_for_any_chain_is_let_go_and_counted(tmp_path: Path, code: str) -> None:
    """A robot that was switched off for days must be able to work again; the owner sees the gap."""
    run = Run(tmp_path, clips=2)
    run.network.verdict = code

    assert run_virtual(run.deliver_all()).dropped_count == 2
    assert (run.spool.names(), run.done) == ([], [])


def test_a_visit_whose_key_another_robot_took_stops_no_robot(tmp_path: Path) -> None:
    """Another robot that sees announcements on their way, and lies, could otherwise end every run of it, for good."""
    run = Run(tmp_path / "spool", clips=2)
    owner = run.spool.get(run.names[0]).owner
    run.network.others_visits = {owner}
    run.network.upload_refusals = ["VISIT_NOT_OPEN"] * 10_000

    async def main() -> dict[bytes, int]:
        delivery = await run.deliver_all()
        visits = UnclosedVisitStore(tmp_path / "visits", KEY)
        visits.count(owner, 2)
        await delivery.close_visits(visits)
        assert delivery.dropped_count == 2
        return visits.counts

    assert run_virtual(main()) == {}
    assert (run.spool.names(), run.done, run.network.closed) == ([], [], {})


def test_a_fresh_clip_that_the_chain_calls_too_old_or_ahead_is_kept(tmp_path: Path) -> None:
    """Then a clock is wrong, which a person can put right."""
    run = with_fresh_clip(tmp_path)
    run.network.verdict = "BUCKET_WRONG"
    assert refused(run.deliver_all()).code == "NOT_PERMITTED"
    assert run.spool.names() == run.names


def test_a_clip_whose_person_said_no_is_destroyed_before_anything_is_announced(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.refused = {run.spool.get(run.names[0]).upload.record_id}
    run_virtual(run.deliver_all())
    assert (run.network.calls, run.network.uploads, run.done) == ([], {}, [])
    assert len(run.dropped) == 1
    assert list(tmp_path.iterdir()) == []


@in_virtual_time
async def test_a_no_that_comes_while_the_network_is_away_stops_what_waits(tmp_path: Path) -> None:
    """Sealed and spooled, tried again and again: once the network is back nothing of it is recorded."""
    run = Run(tmp_path, clips=3)
    run.network.refusals = ["NODE_UNREACHABLE"] * 10_000
    delivery = run.delivery()
    for name in run.names:
        delivery.start(name)
    await asyncio.sleep(30)
    run.refused = {run.spool.get(name).upload.record_id for name in run.names}
    run.network.refusals = []
    await delivery.drain()
    await delivery.stop()
    assert (run.network.visits, run.network.records, run.network.uploads) == ({}, {}, {})
    assert (len(run.dropped), run.spool.names()) == (3, [])


@in_virtual_time
async def test_a_no_after_the_visit_was_announced_stops_the_records(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=2)
    delivery = run.delivery()
    await delivery.announce(run.spool.get(run.names[0]))
    run.refused = {run.spool.get(run.names[1]).upload.record_id}
    for name in run.names:
        delivery.start(name)
    await delivery.drain()
    assert (len(run.network.records), len(run.done), len(run.dropped), run.spool.names()) == (1, 1, 1, [])


def test_a_no_that_comes_during_the_upload_stops_the_record(tmp_path: Path) -> None:
    """Custodians have it by then; they purge what no transaction came for."""
    run = Run(tmp_path)
    run.network.on_upload = lambda upload: run.refused.add(upload.record_id)
    run_virtual(run.deliver_all())
    assert (run.network.times("record"), run.network.records, run.done) == ([], {}, [])
    assert (len(run.dropped), run.spool.names()) == (1, [])


def test_the_end_of_one_clips_consent_does_not_take_another_of_the_visit_along(tmp_path: Path) -> None:
    """A consent's period ended between the two: the first may not announce the visit, the second may."""
    run = Run(tmp_path, clips=2)
    run.refused = {run.spool.get(run.names[0]).upload.record_id}
    run_virtual(run.deliver_all())
    assert (len(run.network.records), len(run.dropped), run.spool.names()) == (1, 1, [])


def test_a_clip_of_a_killed_robot_is_asked_about_again(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=2)

    async def first_life() -> None:
        run.network.refusals = ["NODE_UNREACHABLE"] * 10_000
        delivery = run.delivery()
        for name in run.names:
            delivery.start(name)
        await asyncio.sleep(5)
        await delivery.stop()

    run_virtual(first_life())
    run.network.refusals = []
    run.spool = Spool(tmp_path, KEY)
    run.refused = {run.spool.get(run.names[0]).upload.record_id}
    run_virtual(run.deliver_all())
    assert (len(run.network.records), len(run.dropped), run.spool.names()) == (1, 1, [])
