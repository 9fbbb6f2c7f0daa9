"""The audit trail: all of it, in order, each entry proven, and asked for under the visit's own key."""

from __future__ import annotations

from clients.wallet.ledger.visit_audit import audit_all, audit_visit
from tests.world.dicts import NOW_MS, World


async def test_a_visits_trail_is_read_in_order(world: World) -> None:
    visit = world.open_visit()
    world.write_audit(visit, ["visit_opened", "recorded", "access_requested"])
    (known,) = await world.wallet.scan()
    entries = await audit_visit(world.wallet, known)
    assert [(entry.index, entry.kind, entry.time_ms) for entry in entries] == [
        (0, "visit_opened", NOW_MS),
        (1, "recorded", NOW_MS + 1),
        (2, "access_requested", NOW_MS + 2),
    ]


async def test_a_long_trail_is_read_whole(world: World) -> None:
    visit = world.open_visit()
    world.write_audit(visit, ["recorded"] * 233)
    (known,) = await world.wallet.scan()
    assert [entry.index for entry in await audit_visit(world.wallet, known)] == list(range(233))


async def test_the_trails_of_all_visits_stand_in_the_order_of_the_chain(world: World) -> None:
    for start in (2, 1):
        world.write_audit(world.open_visit(), ["visit_opened", "recorded", "visit_closed"], height=start)
    heights = [entry.height for entry in await audit_all(world.wallet)]
    assert heights == [1, 2, 3, 4, 5, 6]


async def test_each_trail_is_asked_for_under_its_own_key(world: World) -> None:
    visits = [world.open_visit(), world.open_visit()]
    for visit in visits:
        world.write_audit(visit, ["visit_opened"])
    await audit_all(world.wallet)
    for what, key in world.network.asked:
        if what.startswith("audit"):
            assert key.decode("latin-1") in what


async def test_a_visit_without_events_has_an_empty_trail(world: World) -> None:
    world.open_visit()
    assert await audit_all(world.wallet) == []
