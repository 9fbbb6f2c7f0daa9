"""What an operator is told of the receipts that the chain waits for, without holding up the node."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import msgspec
from prometheus_client.parser import text_string_to_metric_families

from consensus.errors import BlockRobotError
from network.custody.custody_text import scrub_sentences
from node.custody.coordination.custody_admin import ERASURES_READ_AGAIN_MS, CustodyAdmin, describe_scrub
from node.custody.coordination.custody_answers import FrameName, PartName, UploadReport
from node.custody.coordination.work_failures import WorkFailures
from node.custody.repair.scrub import ScrubReport
from node.custody.stores.custody_store import Checkpoint
from tests.offchain.house import ERASURE_ID, CustodianHarness, refused
from tests.offchain.small_chain import CUSTODIAN, OTHER_CUSTODIAN, START_MS, record_clip
from tests.offchain.small_state import State

NOW_MS = START_MS + 1_000_000


class Snapshot:
    """One version of a ledger that the test put together."""

    def __init__(self, state: State, note: Callable[[bytes], None]) -> None:
        self.position = Checkpoint(100, bytes(32), START_MS)
        self._state, self._note = state.facts()._state, note

    def __enter__(self) -> Snapshot:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def get(self, _key: bytes) -> bytes | None:
        return None

    def scan(self, prefix: bytes, limit: int) -> Any:
        self._note(prefix)
        return self._state.scan(prefix, limit)


async def no_uploads(_timestamp_ms: int, *, counts_held: bool) -> UploadReport:
    return UploadReport([], {}, 0, None, None, uploads_paused=False, days_until_reserve=None)


def make_custody_admin(
    house: CustodianHarness,
    state: State,
    note: Callable[[bytes], None] = lambda _prefix: None,
    failing: WorkFailures | None = None,
) -> CustodyAdmin:
    class Ledger:
        def snapshot(self) -> Snapshot:
            return Snapshot(state, note)

    ledger: Any = Ledger()
    parts = {"custodian": house.custodian, "store": house.store, "keys": house.keys, "ledger": ledger}
    parts["failing"] = failing or WorkFailures(lambda: NOW_MS)
    serving = {"find_peers": list, "is_serving": lambda: True, "describe_uploads": no_uploads}
    return CustodyAdmin(name="node-1", member=CUSTODIAN, clock=lambda: NOW_MS, **parts, **serving)


async def test_who_owes_which_receipt_and_which_of_them_are_overdue(opened: CustodianHarness) -> None:
    state = State()
    state.erasure(record_clip(), receipts=[CUSTODIAN], time=NOW_MS - 121_000)
    status = await make_custody_admin(opened, state).status()
    overdue = [{"erasure_id": ERASURE_ID.hex(), "age_s": 121, "records": 1}]
    assert msgspec.to_builtins(status.waiting_for) == {OTHER_CUSTODIAN.hex(): {"receipts": 1, "overdue": overdue}}
    state.erasure(record_clip(), receipts=[CUSTODIAN], time=NOW_MS - 119_000)
    status = await make_custody_admin(opened, state).status()
    assert msgspec.to_builtins(status.waiting_for) == {OTHER_CUSTODIAN.hex(): {"receipts": 1, "overdue": []}}


async def test_metrics_count_what_each_custodian_owes_and_read_all_erasures_once_a_minute(
    opened: CustodianHarness,
) -> None:
    state, now = State(), [NOW_MS]
    state.erasure(record_clip(), receipts=[CUSTODIAN], time=NOW_MS - 121_000)
    admin = make_custody_admin(opened, state)
    admin._clock = lambda: now[0]

    async def read() -> dict[tuple[str, str], float]:
        families = text_string_to_metric_families((await admin.metrics()).decode())
        samples = [sample for family in families for sample in family.samples if "custodian" in sample.labels]
        return {(s.name.removeprefix("blockrobot_erasures_"), s.labels["custodian"]): s.value for s in samples}

    own, other = CUSTODIAN.hex(), OTHER_CUSTODIAN.hex()
    owed = {("unconfirmed", own): 0, ("overdue", own): 0, ("unconfirmed", other): 1, ("overdue", other): 1}
    assert await read() == owed
    state.erasure(record_clip(), receipts=[CUSTODIAN, OTHER_CUSTODIAN])
    now[0] += ERASURES_READ_AGAIN_MS - 1
    assert await read() == owed
    now[0] += 1
    assert await read() == {("unconfirmed", own): 0, ("overdue", own): 0}


async def test_what_everybody_confirmed_costs_no_search_in_the_audit_and_nothing_waits_meanwhile(
    opened: CustodianHarness,
) -> None:
    """There are ever more of them: the node's own work must not stand still while they are passed over."""
    state, threads, prefixes = State(), set(), []

    def note(prefix: bytes) -> None:
        threads.add(threading.get_ident())
        prefixes.append(prefix)

    state.erasure(record_clip(), receipts=[CUSTODIAN, OTHER_CUSTODIAN])
    assert (await make_custody_admin(opened, state, note).status()).waiting_for == {}
    assert prefixes == [b"erasure\x00erasure/"]
    assert threading.get_ident() not in threads


def test_what_a_scrub_found_is_told_by_name_and_no_list_is_longer_than_a_thousand_but_counted() -> None:
    many = [bytes([0, number // 256, number % 256]) for number in range(1_001)]
    answer = describe_scrub(
        ScrubReport(height=7, missing=many, corrupted=[(b"r", 3)], parts_held_though_ended=[(b"g", b"r")])
    )
    assert answer.missing == [each.hex() for each in many[:-1]]
    assert answer.corrupted == [FrameName(record=b"r".hex(), frame=3)]
    assert answer.parts_held_though_ended == [PartName(grant=b"g".hex(), record=b"r".hex())]
    assert (answer.ok, answer.height, answer.log_bytes) == (False, 7, None)
    assert (answer.counts["missing"], answer.counts["corrupted"], answer.counts["other_facts"]) == (1_001, 1, 0)
    assert any("1001 records are missing" in line for line in scrub_sentences("node-1", answer))


async def test_who_waits_for_a_custodian_that_cannot_follow_hears_why(opened: CustodianHarness) -> None:
    failing = WorkFailures(lambda: NOW_MS)
    admin = make_custody_admin(opened, State(), failing=failing)

    async def wait_in_vain() -> None:
        async with admin._work():
            raise BlockRobotError("CUSTODY_CATCHING_UP")

    await refused("CUSTODY_CATCHING_UP", wait_in_vain())
    with suppress(BlockRobotError), failing.noted("following"):
        raise BlockRobotError("STORE_UNAVAILABLE", "No server.")
    await refused("STORE_UNAVAILABLE", wait_in_vain())
    [row] = (await admin.status()).failing
    assert (row.work, row.detail) == ("following", "No server.")
