"""A robot's word held against its owners': every kept frame once, with the one it belongs to, and nothing else."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

from network.bench.robot.robot_counts import (
    FrameAccount,
    LoggedFrames,
    Timed,
    account_for_frames,
    caught_up_at_ms,
    match_owners,
    read_frames,
    untouched_by_cut,
)


def line(activity: str, sequence: int, alias: str = "", at_ms: int = 0, **detail: int) -> str:
    row: dict[str, Any] = {"time_ms": at_ms, "activity": activity, "case": f"frame-{sequence}"}
    return json.dumps(row | ({"alias": alias} if alias else {}) | ({"detail": detail} if detail else {}))


def story(*, final: tuple[int, ...] = (0, 1, 2), withheld: tuple[int, ...] = (3,)) -> list[str]:
    """A log of four frames, paired with two people; B is kept whole."""
    lines = [line("IMAGE_RETRIEVE", number) for number in range(4)]
    for alias in ("tag-a", "tag-b"):
        lines += [line("IMAGE_PAIRED", number, alias) for number in range(4)]
    lines += [line("BLOCKCHAIN_TRANSACTION", number, "tag-a", 900, decided_at_ms=500) for number in final]
    lines += [line("IMAGE_WITHHELD", number, "tag-a", reason=1) for number in withheld]
    lines += [line("BLOCKCHAIN_TRANSACTION", number, "tag-b", 700 + number, decided_at_ms=500) for number in range(4)]
    return lines


A_FOUND, B_FOUND = Counter([0, 1, 2]), Counter([0, 1, 2, 3])


def test_nothing_is_wrong_where_log_and_owners_agree_and_what_nobody_finds_is_lost() -> None:
    logged = read_frames(story())
    assert (
        account_for_frames(logged, [A_FOUND, B_FOUND])
        == account_for_frames(logged, [B_FOUND, A_FOUND])
        == FrameAccount(0, 0, 0)
    )
    logged = read_frames(story())
    assert account_for_frames(logged, [B_FOUND]).lost == 3
    assert account_for_frames(logged, []).lost == 7
    assert account_for_frames(LoggedFrames(), [A_FOUND]) == FrameAccount(0, 0, 3)


def test_the_log_tells_how_long_each_kept_frame_took_and_how_many_were_taken_up() -> None:
    times = read_frames(story()).times
    assert sorted(time.took_ms for time in times) == [200, 201, 202, 203, 400, 400, 400]
    lines = [line("IMAGE_RETRIEVE", number, at_ms=1_000 + 40 * number) for number in range(5)]
    assert read_frames(lines).frames_per_s == 25.0
    assert read_frames(lines[:1]).frames_per_s == read_frames([]).frames_per_s == 0.0
    row = json.dumps({"time_ms": 1, "activity": "RFID_RETRIEVE", "case": "tag-a", "alias": "tag-a"})
    assert read_frames([row]) == LoggedFrames()


def test_a_frame_that_nobody_finds_is_lost_and_one_at_the_wrong_owner_unexplained_there() -> None:
    assert account_for_frames(read_frames(story()), [A_FOUND, Counter([0, 1, 3])]) == FrameAccount(
        lost=1, doubled=0, unexplained=0
    )
    logged = read_frames(story(final=(0, 1), withheld=(3,)))
    assert account_for_frames(logged, [Counter([0, 1]), B_FOUND]).lost == 1
    logged = read_frames(story(final=(0, 1), withheld=(2, 3)))
    assert account_for_frames(logged, [Counter([0, 3]), B_FOUND]) == FrameAccount(lost=1, doubled=0, unexplained=1)


def test_a_frame_found_or_logged_twice_or_kept_and_withheld_is_doubled() -> None:
    assert account_for_frames(read_frames(story()), [A_FOUND, B_FOUND + Counter([2])]).doubled == 1
    assert account_for_frames(read_frames(story(final=(0, 1, 2, 2))), [A_FOUND, B_FOUND]).doubled == 1
    assert account_for_frames(read_frames(story(withheld=(2, 3))), [A_FOUND, B_FOUND]).doubled == 1


def test_aliases_are_given_to_owners_as_most_frames_agree() -> None:
    one, other = Counter(range(10)), Counter(range(5, 30))
    pairs = match_owners({"tag-x": other, "tag-y": one}, [Counter(range(9)), Counter(range(6, 30))])
    assert [(len(kept), len(found)) for kept, found in pairs] == [(25, 24), (10, 9)]


def test_what_a_cut_delayed_is_told_apart_from_the_rest() -> None:
    before, across, within, behind, after = (
        Timed(0, 50),
        Timed(90, 310),
        Timed(150, 350),
        Timed(320, 360),
        Timed(360, 400),
    )
    times = [before, across, within, behind, after]
    assert caught_up_at_ms(times, 300) == 350
    assert untouched_by_cut(times, 100, 350) == [before, after]


def test_a_cut_that_delayed_nothing_is_over_when_it_ends() -> None:
    assert caught_up_at_ms([Timed(0, 50)], 300) == 300
    assert caught_up_at_ms([], 300) == 300
