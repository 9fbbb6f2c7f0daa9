"""The robot's view of the registry: what counts as a yes, from when, for how long, and that doubt is a no."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from clients.robot.consent.consent_view import (
    CLOCK_AHEAD_MAX_MS,
    READ_WHOLE_EVERY_MS,
    REFRESH_EVERY_MS,
    SETTLED_AFTER_MS,
    STALE_AFTER_MS,
    Consents,
    compute_stale_after_ms,
)
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.recording.spool import SpooledClip
from consensus.errors import BlockRobotError
from consensus.members.roster import ROSTER_VERSION, Roster, RosterRow
from consensus.state import consent, identity
from consensus.state.consent import CHOICES
from consensus.state.identity import HANDLE, MEMBER, REGISTRAR
from tests.unit.clients.robot.registry_stand_in import PERSON_KEY, ROBOT, SIGNER, RegistryStandIn, consents_on
from tests.unit.clients.robot.test_spool import clip
from tests.virtual_time import in_virtual_time, run_virtual, virtual_now_ms

ANN, BEN = b"a" * 32, b"b" * 32
DAY_MS = 24 * 3600 * 1000
STEP_MS = 300_000
COUNTS = [identity.CHANGES.flat, consent.CHANGES.flat]


def row(handle: bytes) -> RosterRow:
    return RosterRow(
        tag=handle, handle=handle, spend=ROBOT.public_key, view=ROBOT.public_key, sealing=b"X" * 32, proof=b""
    )


def roster(*handles: bytes) -> Roster:
    rows = tuple(map(row, handles or (ANN, BEN)))
    return Roster(ROSTER_VERSION, bytes(32), ROBOT.public_key, bytes(32), 0, 1 << 50, rows)


class Ward:
    """A registry of ann and ben, the robot's view of it, and a clock that is the robot's."""

    def __init__(self, *handles: bytes) -> None:
        self.off_ms = 0
        self.known = roster(*handles)
        self.registry = RegistryStandIn(self.known, virtual_now_ms)
        self.notices: list[str] = []
        self.consents = consents_on(self.registry, self.known, tell=self.notices.append)
        self.consents._now_ms = lambda: virtual_now_ms() + self.off_ms

    def refusal(
        self, handle: bytes = ANN, purpose: str = "demo", sensor: str = "depth", taken_at_ms: int | None = None
    ) -> WithholdReason | None:
        at_ms = virtual_now_ms() if taken_at_ms is None else taken_at_ms
        return self.consents.check_may_keep(handle, purpose, sensor, at_ms)

    def clip(self, handle: bytes = ANN, from_ms: int | None = None, until_ms: int | None = None) -> SpooledClip:
        now = virtual_now_ms()
        return msgspec.structs.replace(
            clip(),
            person=self.consents.person_tag(handle),
            captured_from_ms=now if from_ms is None else from_ms,
            captured_until_ms=now if until_ms is None else until_ms,
            decided_at_ms=now,
        )


def story(*handles: bytes) -> Callable[[Callable[[Ward], Any]], Callable[[], None]]:
    """Run a story in virtual time, on a ward of its own."""

    def wrap(tell: Callable[[Ward], Any]) -> Callable[[], None]:
        def test() -> None:
            async def main() -> None:
                await tell(Ward(*handles))

            run_virtual(main())

        test.__name__, test.__doc__ = tell.__name__, tell.__doc__
        return test

    return wrap


@story()
async def test_before_the_first_reading_everything_is_refused(ward: Ward) -> None:
    ward.registry.say(ANN)
    assert ward.refusal() is WithholdReason.STALE


@story()
async def test_only_a_consent_to_this_purpose_and_this_sensor_is_one(ward: Ward) -> None:
    ward.registry.say(ANN, purpose="demo", sensor="depth")
    await ward.consents.refresh()
    assert ward.refusal() is None
    for other in ({"purpose": "care"}, {"sensor": "rgb"}, {"handle": BEN}, {"handle": b"?" * 32}):
        assert ward.refusal(**other) is WithholdReason.NO_CONSENT  # type: ignore[arg-type]


@story()
async def test_a_person_of_whom_the_chain_says_otherwise_than_the_roster_is_not_confirmed(ward: Ward) -> None:
    for handle in (ANN, BEN):
        ward.registry.say(handle)
    member = ward.registry.state[b"identity\x00handle/" + ANN]
    ward.registry.state[MEMBER.key(member)]["sealing"] = b"?" * 32
    await ward.consents.refresh()
    assert (len(ward.consents), ward.refusal(ANN), ward.refusal(BEN)) == (1, WithholdReason.NO_CONSENT, None)


@story()
async def test_who_left_or_never_registered_is_refused_whatever_stands_in_her_row(ward: Ward) -> None:
    for handle in (ANN, BEN):
        ward.registry.say(handle)
    ward.registry.leave(ANN)
    del ward.registry.state[b"identity\x00handle/" + BEN]
    await ward.consents.refresh()
    assert (ward.refusal(ANN), ward.refusal(BEN)) == (WithholdReason.NO_CONSENT, WithholdReason.NO_CONSENT)


@pytest.mark.parametrize("no", ["withdrawn", "refused"])
@in_virtual_time
async def test_a_no_counts_from_the_reading_that_sees_it_for_every_picture_that_waits(no: str) -> None:
    ward = Ward()
    ward.registry.say(ANN)
    await ward.consents.refresh()
    await asyncio.sleep(5)
    taken_ms = virtual_now_ms()
    ward.registry.say(ANN, no)
    assert ward.refusal(taken_at_ms=taken_ms) is None, "the robot cannot know yet"
    ward.registry.idle = True
    await ward.consents.refresh()
    assert ward.refusal(taken_at_ms=taken_ms) is WithholdReason.NO_CONSENT, "though it holds by the next block only"
    assert ward.refusal(taken_at_ms=taken_ms + 60_000) is WithholdReason.NO_CONSENT


@story()
async def test_a_break_between_two_readings_is_not_slept_through(ward: Ward) -> None:
    ward.registry.say(ANN)
    await asyncio.sleep(10)
    await ward.consents.refresh()
    taken_ms = virtual_now_ms()
    await asyncio.sleep(2)
    ward.registry.say(ANN, "withdrawn")
    ward.registry.say(ANN)
    again_ms = virtual_now_ms()
    await ward.consents.refresh()
    assert ward.refusal(taken_at_ms=taken_ms) is WithholdReason.OUTSIDE
    assert ward.refusal(taken_at_ms=again_ms) is None


@story()
async def test_a_view_that_no_block_renews_goes_stale_and_comes_back(ward: Ward) -> None:
    """Nodes that are cut off from the others go on to answer, with ever older headers."""
    ward.registry.say(ANN)
    await ward.consents.refresh()
    ward.registry.idle = True
    await asyncio.sleep(STALE_AFTER_MS / 1000 - 1)
    await ward.consents.refresh()
    assert ward.refusal() is None
    await asyncio.sleep(2)
    await ward.consents.refresh()
    assert ward.refusal() is WithholdReason.STALE
    assert ward.registry.caught_up >= 1, "other nodes were asked for a newer header"
    ward.registry.idle = False
    await ward.consents.refresh()
    assert ward.refusal() is None


@story()
async def test_a_registry_that_cannot_be_reached_closes_and_opens_again(ward: Ward) -> None:
    ward.registry.say(ANN)
    await ward.consents.refresh()
    watch = asyncio.create_task(ward.consents.watch())
    ward.registry.failure = "NODE_UNREACHABLE"
    await asyncio.sleep(STALE_AFTER_MS / 1000 - 10)
    assert ward.refusal() is None
    assert ward.notices == []
    await asyncio.sleep(70)
    assert ward.refusal() is WithholdReason.STALE
    (waits,) = ward.notices
    assert "nothing becomes final: the robot waits" in waits
    ward.registry.failure = ""
    await asyncio.sleep(2)
    assert ward.refusal() is None
    watch.cancel()
    assert len(ward.notices) == 2
    assert ward.notices[1].startswith("The network makes blocks again, after ")
    told = ward.consents.summarise()
    assert told.stale_times == 1
    assert 55_000 <= told.stale_ms <= 65_000
    assert told.failed_readings >= 100


@pytest.mark.parametrize(
    ("off_ms", "expected"),
    [
        (3_600_000, WithholdReason.STALE),
        (-3_600_000, WithholdReason.STALE),
        (-CLOCK_AHEAD_MAX_MS - 500, WithholdReason.STALE),
        (STALE_AFTER_MS + 1, WithholdReason.STALE),
        (-CLOCK_AHEAD_MAX_MS + 100, None),
    ],
)
@in_virtual_time
async def test_a_robot_whose_clock_is_wrong_keeps_nothing(off_ms: int, expected: WithholdReason | None) -> None:
    ward = Ward()
    ward.registry.say(ANN, since_ms=virtual_now_ms() - DAY_MS)
    await ward.consents.refresh()
    ward.off_ms = off_ms
    assert ward.refusal() is expected


def test_an_idle_chain_with_slow_heartbeats_is_not_taken_for_a_dead_one() -> None:
    assert compute_stale_after_ms(30_000) == STALE_AFTER_MS
    assert compute_stale_after_ms(600_000) == 1_200_000


@story()
async def test_the_registry_is_asked_for_whole_and_only_when_it_changed(ward: Ward) -> None:
    """What is asked for never depends on who stands before the robot."""
    ward.registry.say(ANN)
    await ward.consents.refresh()
    members = [ward.registry.state[HANDLE.key(handle)] for handle in (ANN, BEN)]
    office = [MEMBER.key(ROBOT.public_key), REGISTRAR.key(SIGNER)]
    whole = [
        *COUNTS,
        *office,
        *(HANDLE.key(handle) for handle in (ANN, BEN)),
        *(MEMBER.key(member) for member in members),
        *(CHOICES.key(handle) for handle in (ANN, BEN)),
    ]
    assert ward.registry.asked == whole
    ward.registry.asked.clear()
    await ward.consents.refresh()
    assert ward.registry.asked == [*COUNTS, *office]
    ward.registry.asked.clear()
    ward.registry.say(BEN, "refused")
    await ward.consents.refresh()
    assert ward.registry.asked == whole


@story()
async def test_now_and_then_everything_is_read_though_no_number_says_so(ward: Ward) -> None:
    """The numbers are kept by a contract that may one day have a fault."""
    ward.registry.say(ANN)
    await ward.consents.refresh()
    ward.registry.state[CHOICES.key(ANN)]["demo"]["depth"][-1][1] = "withdrawn"
    await ward.consents.refresh()
    assert ward.refusal() is None
    await asyncio.sleep(READ_WHOLE_EVERY_MS / 1000)
    await ward.consents.refresh()
    assert ward.refusal() is WithholdReason.NO_CONSENT


@story(*(bytes([number]) * 32 for number in range(200)))
async def test_a_large_roster_is_read_in_parts(ward: Ward) -> None:
    for number in range(200):
        ward.registry.say(bytes([number]) * 32)
    await ward.consents.refresh()
    assert len(ward.consents) == 200
    assert not any(ward.refusal(bytes([number]) * 32) for number in range(200))


@story()
async def test_a_clip_waits_for_a_look_at_the_registry_after_its_last_picture(ward: Ward) -> None:
    ward.registry.say(ANN)
    await asyncio.sleep(5)
    await ward.consents.refresh()
    await asyncio.sleep(0.5)
    sealed = ward.clip()
    ward.registry.say(ANN, "withdrawn")
    asked = asyncio.create_task(ward.consents.may_record_clip(sealed))
    await asyncio.sleep(0.1)
    assert not asked.done(), "the view is older than the picture"
    watch = asyncio.create_task(ward.consents.watch())
    assert await asked is False
    watch.cancel()


@story()
async def test_on_an_idle_chain_a_clip_waits_until_a_no_of_its_time_would_be_final(ward: Ward) -> None:
    """A block of before may not be final yet, and hold a no; so a look right after the picture is not enough."""
    ward.registry.say(ANN)
    await asyncio.sleep(1)
    await ward.consents.refresh()
    ward.registry.idle = True
    watch = asyncio.create_task(ward.consents.watch())
    await asyncio.sleep(0.1)
    sealed, started_ms = ward.clip(), virtual_now_ms()
    assert await ward.consents.may_record_clip(sealed) is True
    assert SETTLED_AFTER_MS <= virtual_now_ms() - started_ms <= SETTLED_AFTER_MS + 2 * REFRESH_EVERY_MS
    ward.registry.idle = False
    started_ms = virtual_now_ms()
    assert await ward.consents.may_record_clip(ward.clip()) is True
    assert virtual_now_ms() - started_ms <= 2 * REFRESH_EVERY_MS
    watch.cancel()


@story()
async def test_a_look_for_one_clip_is_not_late_enough_for_the_next(ward: Ward) -> None:
    ward.registry.say(ANN)
    await asyncio.sleep(1)
    await ward.consents.refresh()
    ward.registry.idle = True
    watch = asyncio.create_task(ward.consents.watch())
    await asyncio.sleep(0.1)
    first = asyncio.create_task(ward.consents.may_record_clip(ward.clip()))
    await asyncio.sleep(SETTLED_AFTER_MS / 1000 - 0.5)
    second, started_ms = ward.clip(), virtual_now_ms()
    assert await ward.consents.may_record_clip(second) is True
    assert virtual_now_ms() - started_ms >= SETTLED_AFTER_MS
    assert await first is True
    watch.cancel()


@story()
async def test_what_a_node_says_that_is_cut_off_brings_no_clip_to_the_chain(ward: Ward) -> None:
    """She says no on the other side of the cut; the robot's node knows nothing of it, and answers well."""
    ward.registry.say(ANN)
    await asyncio.sleep(1)
    await ward.consents.refresh()
    ward.registry.cut_off = ward.registry.idle = True
    watch = asyncio.create_task(ward.consents.watch())
    await asyncio.sleep(2)
    asked = asyncio.create_task(ward.consents.may_record_clip(ward.clip()))
    await asyncio.sleep(60 - 2)
    assert not asked.done()
    assert ward.consents.is_fresh(), "nor is the view old yet"
    assert ward.registry.quorums_asked > 10
    ward.registry.cut_off = ward.registry.idle = False
    ward.registry.say(ANN, "withdrawn")
    assert await asked is False
    watch.cancel()


@story()
async def test_others_are_asked_only_while_a_clip_waits_that_no_block_came_for(ward: Ward) -> None:
    ward.registry.say(ANN)
    watch = asyncio.create_task(ward.consents.watch())
    await asyncio.sleep(30)
    assert await ward.consents.may_record_clip(ward.clip()) is True
    ward.registry.idle = True
    await asyncio.sleep(30)
    assert ward.registry.quorums_asked == 0
    assert await ward.consents.may_record_clip(ward.clip()) is True
    assert ward.registry.quorums_asked == 1
    watch.cancel()


@story()
async def test_one_node_that_takes_the_robot_for_no_member_ends_nothing(ward: Ward) -> None:
    ward.registry.say(ANN)
    await ward.consents.refresh()
    watch = asyncio.create_task(ward.consents.watch())
    ward.registry.failure, ward.registry.others_serve = "SESSION_REFUSED", True
    asked = asyncio.create_task(ward.consents.may_record_clip(ward.clip()))
    await asyncio.sleep(5)
    assert not asked.done()
    assert ward.refusal() is None
    ward.registry.failure = ""
    assert await asked is True
    watch.cancel()


@story()
async def test_a_robot_that_is_a_member_again_goes_on(ward: Ward) -> None:
    ward.registry.say(ANN)
    watch = asyncio.create_task(ward.consents.watch())
    ward.registry.failure = "SESSION_REFUSED"
    await asyncio.sleep(3)
    with pytest.raises(BlockRobotError, match="SESSION_REFUSED"):
        ward.consents.raise_failure()
    ward.registry.failure = ""
    await asyncio.sleep(2)
    ward.consents.raise_failure()
    assert await ward.consents.may_record_clip(ward.clip()) is True
    watch.cancel()


@story()
async def test_a_view_that_turns_stale_while_a_clip_is_judged_destroys_nothing(ward: Ward) -> None:
    ward.registry.say(ANN, since_ms=virtual_now_ms() - DAY_MS)
    await ward.consents.refresh()
    sealed = ward.clip(until_ms=virtual_now_ms() - 1_000)
    find, times = ward.consents.check_may_keep, [WithholdReason.STALE]
    ward.consents.check_may_keep = lambda *told: times.pop() if times else find(*told)  # type: ignore[method-assign]
    asked = asyncio.create_task(ward.consents.may_record_clip(sealed))
    await asyncio.sleep(0.1)
    assert not asked.done()
    watch = asyncio.create_task(ward.consents.watch())
    assert await asked is True
    watch.cancel()


@story()
async def test_a_clip_waits_out_a_registry_that_is_away_and_is_then_judged(ward: Ward) -> None:
    for handle in (ANN, BEN):
        ward.registry.say(handle, since_ms=virtual_now_ms() - DAY_MS)
    await ward.consents.refresh()
    ward.registry.failure = "NODE_UNREACHABLE"
    watch = asyncio.create_task(ward.consents.watch())
    await asyncio.sleep(0.5)
    asked = [asyncio.create_task(ward.consents.may_record_clip(ward.clip(handle))) for handle in (ANN, BEN)]
    await asyncio.sleep(600)
    assert not any(task.done() for task in asked)
    ward.registry.failure = ""
    ward.registry.say(BEN, "withdrawn")
    assert await asyncio.gather(*asked) == [True, False]
    watch.cancel()


@story()
async def test_a_clip_of_nobody_on_the_roster_is_not_recorded(ward: Ward) -> None:
    ward.registry.say(ANN)
    await ward.consents.refresh()
    assert await ward.consents.may_record_clip(ward.clip(b"?" * 32, until_ms=virtual_now_ms() - 100)) is False


@story()
async def test_a_clip_that_reaches_out_of_the_consent_at_either_end_is_not_recorded(ward: Ward) -> None:
    await asyncio.sleep(10)
    ward.registry.say(ANN)
    await ward.consents.refresh()
    now = virtual_now_ms()
    assert await ward.consents.may_record_clip(ward.clip(from_ms=now - 5_000, until_ms=now - 100)) is False


@story()
async def test_at_its_end_a_consent_holds_no_more_nor_for_a_clip_that_reaches_there(ward: Ward) -> None:
    end_ms = (virtual_now_ms() // STEP_MS + 1) * STEP_MS
    ward.registry.say(ANN, until_ms=end_ms)
    await asyncio.sleep((end_ms - virtual_now_ms()) / 1000 + 1)
    await ward.consents.refresh()
    assert [ward.refusal(taken_at_ms=at_ms) for at_ms in (end_ms - 1, end_ms)] == [None, WithholdReason.OUTSIDE]
    assert await ward.consents.may_record_clip(ward.clip(from_ms=end_ms - 200, until_ms=end_ms - 100)) is True
    assert await ward.consents.may_record_clip(ward.clip(from_ms=end_ms - 200, until_ms=end_ms)) is False


@story()
async def test_a_recording_that_is_played_faster_than_time_is_judged_when_it_is_sealed(ward: Ward) -> None:
    ward.registry.say(ANN)
    await asyncio.sleep(1)
    await ward.consents.refresh()
    later = virtual_now_ms() + 60_000
    sealed = ward.clip(from_ms=later, until_ms=later)
    watch = asyncio.create_task(ward.consents.watch())
    started = virtual_now_ms()
    assert await ward.consents.may_record_clip(sealed) is True
    assert virtual_now_ms() - started <= 2 * REFRESH_EVERY_MS
    watch.cancel()


@story()
async def test_a_robot_that_was_revoked_stops_rather_than_wait_for_ever(ward: Ward) -> None:
    ward.registry.say(ANN)
    await ward.consents.refresh()
    watch = asyncio.create_task(ward.consents.watch())
    ward.registry.failure = "SESSION_REFUSED"
    await asyncio.sleep(0.1)
    with pytest.raises(BlockRobotError, match="SESSION_REFUSED"):
        await ward.consents.may_record_clip(ward.clip())
    assert ward.refusal() is WithholdReason.STALE
    watch.cancel()


def test_what_stands_for_a_person_in_the_spool_is_no_handle() -> None:
    async def main() -> tuple[bytes, bytes]:
        consents: Consents = Ward().consents
        return consents.person_tag(ANN), consents.person_tag(BEN)

    ann, ben = run_virtual(main())
    assert len({ann, ben, ANN, BEN, PERSON_KEY}) == 5


@story()
async def test_a_terminal_that_is_gone_ends_no_watch(ward: Ward) -> None:
    def tell(_sentence: str) -> None:
        raise BrokenPipeError

    ward.consents = consents_on(ward.registry, ward.known, tell=tell)
    ward.registry.say(ANN)
    await ward.consents.refresh()
    watch = asyncio.create_task(ward.consents.watch())
    ward.registry.failure = "NODE_UNREACHABLE"
    await asyncio.sleep(STALE_AFTER_MS / 1000 + 60)
    assert ward.refusal() is WithholdReason.STALE
    ward.registry.failure = ""
    await asyncio.sleep(2)
    assert ward.refusal() is None
    assert not watch.done()
    watch.cancel()


@story()
async def test_a_roster_of_a_key_that_is_no_registrars_of_the_robots_organisation_ends_the_run(ward: Ward) -> None:
    """A key that was replaced, or another organisation's, could lead a tag to whom it likes."""
    await ward.consents.refresh()
    office = REGISTRAR.key(SIGNER)
    for spoilt in (None, "university"):
        ward.registry.state[office] = spoilt
        with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
            await ward.consents.refresh()
    watch = asyncio.create_task(ward.consents.watch())
    await asyncio.sleep(2 * REFRESH_EVERY_MS / 1000)
    watch.cancel()
    with pytest.raises(BlockRobotError, match="ROSTER_INVALID"):
        ward.consents.raise_failure()
    assert not ward.consents.is_fresh()
