"""Finding visits, listing records, noticing what is missing; and which question is asked in whose session."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import pytest

from clients.sdk.chain.announcements import AnnouncementPage
from clients.sdk.proof_checks import ProvedState
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import Keystore
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import seal_metadata
from consensus.records.metadata import RecordMetadata
from consensus.state.audit import COUNT
from consensus.state.identity import MEMBER, MemberRow
from consensus.state.records import RECORD, VISIT
from tests.world.dicts import World


async def test_a_wallet_finds_its_own_visits_among_strangers(world: World) -> None:
    own = [world.open_visit().owner]
    for _ in range(5):
        world.open_visit(world.stranger())
    own.append(world.open_visit().owner)
    assert [visit.owner for visit in await world.wallet.scan()] == own


async def test_scanning_goes_on_where_it_ended_and_finds_nothing_twice(world: World) -> None:
    world.open_visit()
    await world.wallet.scan()
    asked = len(world.network.asked)
    world.open_visit()
    assert len(await world.wallet.scan()) == 2
    assert len(world.network.asked) == asked + 1
    assert len(Keystore.open(world.store._path, "tea").content.visits) == 2


async def test_a_first_scan_that_is_cut_off_goes_on_where_it_was_saved(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program is killed: nothing of it runs to an end. Pages of two, saved after every four announcements."""
    monkeypatch.setattr("clients.wallet.ledger.wallet.SCAN_SAVED_EVERY_COUNT", 4)
    own = [world.open_visit().owner]
    for _ in range(4):
        world.open_visit(world.stranger())
    own += [world.open_visit().owner, world.open_visit().owner]
    page_of, told = world.network.announcements, list[tuple[int, int]]()

    async def killed(first: int, key: PrivateKey) -> AnnouncementPage:
        if first == 6:
            raise KeyboardInterrupt
        return await page_of(first, key)

    monkeypatch.setattr(world.network, "announcements", killed)
    with pytest.raises(KeyboardInterrupt):
        await world.wallet.scan()
    content = (kept := Keystore.open(world.store._path, "tea")).content
    assert (content.scanned_count, [visit.owner for visit in content.visits]) == (4, own[:1])

    monkeypatch.setattr(world.network, "announcements", page_of)
    world.network.asked.clear()
    again = Wallet(kept, world.genesis)
    again.network, again.tell_scanned = world.wallet.network, lambda done, of: told.append((done, of))
    assert [visit.owner for visit in await again.scan()] == own
    assert [what for what, _ in world.network.asked] == ["announcements"] * 2, "of four pages only the last two"
    assert told == [], "the rest is short"
    again.store.content.scanned_count = 0
    assert len(await again.scan()) == 3
    assert told == [(4, 7)]


async def test_every_wallet_reads_every_announcement_in_the_members_session(world: World) -> None:
    """A node learns nothing from who reads what, if all read all."""
    for _ in range(7):
        world.open_visit(world.stranger())
    await world.wallet.scan()
    assert world.wallet.store.content.scanned_count == 7
    assert {key for what, key in world.network.asked} == {world.keys.identity.public_key}


async def test_whatever_concerns_one_visit_is_asked_under_its_owner_key_alone(world: World) -> None:
    visits = [world.open_visit(), world.open_visit()]
    for visit in visits:
        world.record(visit)
    await world.wallet.records()
    for what, key in world.network.asked:
        if what == "announcements":
            assert key == world.keys.identity.public_key
        else:
            assert key in {visit.owner for visit in visits}
    for visit in visits:
        others = visit.owner.decode("latin-1")
        assert all(others not in what for what, key in world.network.asked if key != visit.owner)


async def test_an_unregistered_wallet_is_told_to_register(world: World) -> None:
    world.store.content.handle = b""
    with pytest.raises(BlockRobotError, match=r"^NOT_REGISTERED:"):
        await world.wallet.records()


async def test_a_restored_wallet_finds_its_registration_on_the_chain(world: World) -> None:
    world.store.content.handle = b""
    row = MemberRow(b"h" * 32, "subject", "hospital", b"", b"", b"", "active", 0)
    world.put(MEMBER, row, world.wallet.keys.identity.public_key)
    assert await world.wallet.records() == []
    assert (world.store.content.handle, world.store.content.role) == (b"h" * 32, "subject")


async def test_records_come_in_the_order_in_which_they_were_taken(world: World) -> None:
    visit = world.open_visit()
    ids = [world.record(visit).upload.record_id for _ in range(5)]
    by_id = sorted(world.network.trails[visit.owner], key=lambda entry: entry.record_id)
    world.network.trails[visit.owner] = []
    for entry in by_id:
        world.append_audit(visit.owner, entry.kind, entry.record_id)
    (report,) = await world.wallet.records()
    assert [entry.record_id for entry in report.records] == ids
    assert [entry.metadata.index_in_visit for entry in report.records] == [0, 1, 2, 3, 4]
    assert report.missing_count == 0


@pytest.mark.parametrize("withheld", [0, 2, 4])
async def test_a_record_that_a_robot_withholds_is_noticed_in_a_closed_visit(world: World, withheld: int) -> None:
    visit = world.open_visit()
    ids = [world.record(visit).upload.record_id for _ in range(5)]
    world.close_visit(visit)
    world.withhold(visit.owner, ids[withheld])
    (report,) = await world.wallet.records()
    assert (report.closed, len(report.records), report.missing_count) == (True, 4, 1)


async def test_a_gap_in_an_open_visit_is_noticed(world: World) -> None:
    visit = world.open_visit()
    ids = [world.record(visit).upload.record_id for _ in range(3)]
    world.withhold(visit.owner, ids[1])
    (report,) = await world.wallet.records()
    assert (report.closed, report.missing_count) == (False, 1)


async def test_no_node_is_asked_for_a_list_that_it_could_shorten(world: World) -> None:
    """The last records of an open visit leave no gap: only the trail, whose length is proven, shows all of them."""
    visit = world.open_visit()
    world.append_audit(visit.owner, "visit_opened")
    ids = [world.record(visit).upload.record_id for _ in range(3)]
    world.append_audit(visit.owner, "access_requested", ids[0])
    (report,) = await world.wallet.records()
    assert [entry.record_id for entry in report.records] == ids
    assert COUNT.key(visit.owner).decode("latin-1") in [what for what, _ in world.network.asked]


async def test_a_record_exchanged_for_one_outside_the_chain_is_noticed(world: World) -> None:
    """The robot's chain of hashes: a record put in the place of another does not follow from the one before."""
    visit = world.open_visit()
    ids = [world.record(visit).upload.record_id for _ in range(3)]
    visit.record_count, visit.previous_hash = 1, b"?" * 32
    world.record(visit)
    visit.record_count = 3
    world.close_visit(visit)
    for true_id in ids[1:]:
        world.withhold(visit.owner, true_id)
    (report,) = await world.wallet.records()
    assert len(report.records) == 2
    assert report.missing_count >= 1


async def test_another_persons_record_is_never_listed(world: World) -> None:
    visit, foreign = world.open_visit(), world.open_visit(world.stranger())
    world.record(visit)
    world.append_audit(visit.owner, "recorded", world.record(foreign).upload.record_id)
    (report,) = await world.wallet.records()
    assert len(report.records) == 1


async def test_erased_records_are_named_and_not_called_missing(world: World) -> None:
    visit = world.open_visit()
    ids = [world.record(visit).upload.record_id for _ in range(4)]
    world.close_visit(visit)
    for record_id in ids[1:3]:
        world.change(RECORD, record_id, status="erased", sealed_metadata=b"")
    (report,) = await world.wallet.records()
    assert set(report.erased_ids) == set(ids[1:3])
    assert (len(report.records), report.missing_count) == (2, 0)


async def test_a_record_that_a_robot_sealed_wrongly_hides_no_other(world: World) -> None:
    visit = world.open_visit()
    ids = [world.record(visit).upload.record_id for _ in range(3)]
    world.close_visit(visit)
    world.change(RECORD, ids[1], sealed_metadata=bytes(560))
    (report,) = await world.wallet.records()
    assert [entry.record_id for entry in report.records] == [ids[0], ids[2]]
    assert (report.unreadable_ids, report.missing_count) == ((ids[1],), 0)


@pytest.mark.parametrize(
    "change",
    [
        {"sensor": "depth\x1b]52;c;cm0gLXJm\x07"},
        {"sensor": "[/]"},
        {"started_at_ms": 1 << 52, "ended_at_ms": 1 << 52},
        {"withheld": (("moved\x1b[2J", 1),)},
    ],
)
async def test_what_a_robot_says_that_no_terminal_and_no_calendar_takes_is_unreadable_and_hides_no_other(
    world: World, change: dict[str, object]
) -> None:
    visit = world.open_visit()
    ids = [world.record(visit).upload.record_id for _ in range(2)]
    world.close_visit(visit)
    row = RECORD.convert(world.network.state[RECORD.key(ids[1])])
    said = decode(world.wallet.open_metadata(row.sealed_metadata)[0], RecordMetadata)
    sealed = seal_metadata(visit.sealing, encode(msgspec.structs.replace(said, **change)))
    world.change(RECORD, ids[1], sealed_metadata=sealed)
    (report,) = await world.wallet.records()
    assert [entry.record_id for entry in report.records] == [ids[0]]
    assert (report.unreadable_ids, report.missing_count) == ((ids[1],), 0)


async def test_a_visit_that_is_proven_absent_is_no_visit(world: World) -> None:
    visit = world.open_visit()
    del world.network.state[VISIT.key(visit.owner)]
    with pytest.raises(BlockRobotError, match=r"^PROOF_INVALID:"):
        await world.wallet.records()


async def test_a_visit_takes_three_questions_one_after_the_other(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands of it and how long its trail is, the trail, the records: each waits for the answer before."""
    visit = world.open_visit()
    for _ in range(3):
        world.record(visit)
    questions, ask = list[int](), world.network.state_values

    async def count(keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        questions.append(len(keys))
        return await ask(keys, key)

    monkeypatch.setattr(world.network, "state_values", count)
    (report,) = await world.wallet.records()
    assert (len(report.records), len(questions)) == (3, 3)


async def test_many_records_are_proven_in_parts(world: World) -> None:
    visit = world.open_visit()
    for _ in range(140):
        world.record(visit, frames=1)
    (report,) = await world.wallet.records()
    assert (len(report.records), report.missing_count) == (140, 0)


async def test_the_newest_verified_header_is_kept_for_the_next_time(world: World) -> None:
    async with world.wallet:
        await world.wallet.scan()
    assert Keystore.open(world.store._path, "tea").content.pin == b"pinned"
