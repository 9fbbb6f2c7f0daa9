"""Which pictures of an empty scene a robot may publish stands on the chain, said by a person of its organisation."""

from __future__ import annotations

import pytest

from consensus.limits import BLOCK_GAS_MAX, CALL_GAS_MAX
from consensus.primitives.hashing import sha256
from tests.unit.contracts.privacy.hospital import Hospital, Person, data_of, key_of

MOST = 128
AT_ONCE = 32


def frame(number: int) -> bytes:
    return sha256(b"empty %d" % number)


def held(hospital: Hospital, robot: bytes) -> list[bytes]:
    return [row[0] for row in hospital.view("records", "empty_frames", robot)]


def test_what_is_approved_is_listed_with_who_said_so_and_when(hospital: Hospital) -> None:
    officer, robot = hospital.enrol("officer", "officer"), hospital.robot.identity.public_key
    told = hospital.must(hospital.admin, "records", "approve_empty_frames", robot, [frame(0)])
    hospital.must(officer.identity, "records", "approve_empty_frames", robot, [frame(0), frame(1)])
    rows = hospital.view("records", "empty_frames", robot)
    assert [row[:2] for row in rows] == [[frame(0), hospital.admin.public_key], [frame(1), officer.identity.public_key]]
    assert all(0 < row[2] <= hospital.time_ms for row in rows)
    admin = hospital.admin.public_key
    assert data_of(told, "empty_frames_approved") == {"robot": robot, "frames": [frame(0)], "approver": admin}


def test_a_withdrawn_frame_is_gone_only_when_no_robot_has_it_any_more(hospital: Hospital) -> None:
    first, second = hospital.robot.identity.public_key, hospital.enrol("second", "robot").identity.public_key
    for robot in (first, second):
        hospital.must(hospital.admin, "records", "approve_empty_frames", robot, [frame(0), frame(1)])
    told = hospital.must(hospital.admin, "records", "withdraw_empty_frames", first, [frame(0)])
    assert data_of(told, "empty_frames_withdrawn")["gone"] == []
    told = hospital.must(hospital.admin, "records", "withdraw_empty_frames", second, [frame(1), frame(0)])
    assert data_of(told, "empty_frames_withdrawn")["gone"] == [frame(0)]
    assert (held(hospital, first), held(hospital, second)) == ([frame(1)], [])
    assert hospital.value("records", b"empty-frame/" + frame(0)) is None


def test_a_robot_has_so_many_at_most_and_a_full_list_costs_a_part_of_a_call(hospital: Hospital) -> None:
    robot = hospital.robot.identity.public_key
    for start in range(0, MOST, AT_ONCE):
        chosen = [frame(number) for number in range(start, start + AT_ONCE)]
        approved = hospital.must(hospital.admin, "records", "approve_empty_frames", robot, chosen)
    more = hospital.send(hospital.admin, "records", "approve_empty_frames", robot, [frame(MOST)])
    assert more.code == "EMPTY_FRAMES_TOO_MANY"
    withdrawn = hospital.must(
        hospital.admin, "records", "withdraw_empty_frames", robot, held(hospital, robot)[:AT_ONCE]
    )
    assert max(approved.gas_used, withdrawn.gas_used) < CALL_GAS_MAX / 2 < BLOCK_GAS_MAX
    hospital.must(hospital.admin, "records", "approve_empty_frames", robot, [frame(MOST)])
    assert len(held(hospital, robot)) == MOST - AT_ONCE + 1


@pytest.mark.parametrize(
    ("frames", "code"),
    [
        ([], "EMPTY_FRAMES_COUNT_WRONG"),
        ([frame(n) for n in range(33)], "EMPTY_FRAMES_COUNT_WRONG"),
        ([b"short"], "EMPTY_FRAME_WRONG"),
        (["text"], "EMPTY_FRAME_WRONG"),
    ],
)
def test_what_names_no_frame_is_refused(hospital: Hospital, frames: list[object], code: str) -> None:
    robot = hospital.robot.identity.public_key
    for entry in ("approve_empty_frames", "withdraw_empty_frames"):
        assert hospital.send(hospital.admin, "records", entry, robot, frames).code == code


def test_only_frames_that_are_approved_are_withdrawn_and_each_once(hospital: Hospital) -> None:
    robot = hospital.robot.identity.public_key
    hospital.must(hospital.admin, "records", "approve_empty_frames", robot, [frame(0)])
    for named in ([frame(1)], [frame(0), frame(0)]):
        refused = hospital.send(hospital.admin, "records", "withdraw_empty_frames", robot, named)
        assert refused.code == "EMPTY_FRAME_UNKNOWN"
    assert held(hospital, robot) == [frame(0)]


def test_nobody_is_no_robot_and_a_revoked_one_publishes_nothing_new(hospital: Hospital) -> None:
    anna, robot = hospital.enrol("anna"), hospital.enrol("gone", "robot")
    for key in (anna.identity.public_key, key_of("stranger").public_key, b""):
        refused = hospital.send(hospital.admin, "records", "approve_empty_frames", key, [frame(0)])
        assert refused.code == "ROBOT_UNKNOWN"
    hospital.must(hospital.admin, "records", "approve_empty_frames", robot.identity.public_key, [frame(0)])
    hospital.must(hospital.admin, "identity", "revoke", robot.handle)
    again = [robot.identity.public_key, [frame(1)]]
    assert hospital.send(hospital.admin, "records", "approve_empty_frames", *again).code == "ROBOT_UNKNOWN"
    hospital.must(hospital.admin, "records", "withdraw_empty_frames", robot.identity.public_key, [frame(0)])


def test_a_robots_new_key_has_no_empty_frame_until_somebody_approves_it_anew(hospital: Hospital) -> None:
    """The name goes with the machine. What pictures show, a person says of each key; whoever stole a key says nothing."""
    old, new = hospital.robot, Person("robot-again")
    keys = [person.identity.public_key for person in (old, new)]
    hospital.must(hospital.admin, "records", "approve_empty_frames", keys[0], [frame(0)])
    hospital.must(old.identity, "identity", "rotate", *hospital.rotation_arguments(old, new))
    assert [held(hospital, key) for key in keys] == [[frame(0)], []], "what stands on it is shown with it still"
    again = hospital.send(hospital.admin, "records", "approve_empty_frames", keys[0], [frame(1)])
    assert again.code == "ROBOT_UNKNOWN", "nothing new is approved for the old key"
    hospital.must(hospital.admin, "records", "approve_empty_frames", keys[1], [frame(0)])
    told = [
        hospital.must(hospital.admin, "records", "withdraw_empty_frames", key, [frame(0)]) for key in reversed(keys)
    ]
    assert [data_of(one, "empty_frames_withdrawn")["gone"] for one in told] == [[], [frame(0)]]
