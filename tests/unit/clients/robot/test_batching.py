"""Frames gather into clips: one owner each, bounded in time, count and bytes; nobody's withheld frames are forgotten."""

from __future__ import annotations

import pytest

from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.frame_redactor import KeptFrame
from clients.robot.recording.batching import Batcher, ReadyClip
from consensus.limits import CLIP_FRAMES_MAX_COUNT


def kept(sequence: int, at_ms: int, alias: str = "ann", size_bytes: int = 10) -> KeptFrame:
    return KeptFrame(sequence, at_ms, alias, EncodedCutout(0, 0, 1, 1, bytes(size_bytes)))


def sequences(clips: list[ReadyClip]) -> list[list[int]]:
    return [[frame.sequence for frame in clip.frames] for clip in clips]


def test_a_clip_spans_less_than_its_length_and_has_no_more_than_a_record_may() -> None:
    batcher = Batcher(500)
    closed = [clip for number in range(12) for clip in batcher.add_kept(kept(number, 100 * number), 0)]
    assert sequences(closed) == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]
    assert sequences(batcher.flush()) == [[10, 11]]
    batcher = Batcher(0)
    assert [sequences(batcher.add_kept(kept(number, number), 0)) for number in range(3)] == [[[0]], [[1]], [[2]]]
    assert batcher.flush() == []
    batcher = Batcher(10**9)
    closed = [
        clip for number in range(2 * CLIP_FRAMES_MAX_COUNT + 1) for clip in batcher.add_kept(kept(number, number), 0)
    ]
    assert [len(clip.frames) for clip in closed] == [CLIP_FRAMES_MAX_COUNT, CLIP_FRAMES_MAX_COUNT]
    batcher = Batcher(10**9)
    closed = [clip for number in range(5) for clip in batcher.add_kept(kept(number, number, size_bytes=2**21), 0)]
    assert sequences(closed) == [[0, 1], [2, 3]]


def test_a_clip_has_one_owner_and_its_withheld_frames_say_nothing_to_another() -> None:
    batcher = Batcher(500)
    for number in range(3):
        batcher.add_kept(kept(number, number, "ann"), 0)
        batcher.add_kept(kept(number, number, "bob"), 0)
    assert {clip.alias: len(clip.frames) for clip in batcher.flush()} == {"ann": 3, "bob": 3}
    batcher.add_withheld("bob", "contact")
    batcher.add_kept(kept(0, 0, "ann"), 0)
    assert {clip.alias: clip.withheld for clip in batcher.flush()} == {"ann": (), "bob": (("contact", 1),)}


def test_an_owner_is_told_with_the_next_clip_what_was_withheld() -> None:
    batcher = Batcher(500)
    batcher.add_withheld("ann", "contact")
    batcher.add_withheld("ann", "contact")
    batcher.add_withheld("ann", "merged")
    batcher.add_kept(kept(3, 100), 0)
    (clip,) = batcher.flush()
    assert clip.withheld == (("contact", 2), ("merged", 1))


def test_withheld_frames_are_counted_once_and_a_tail_that_is_withheld_whole_still_told() -> None:
    batcher = Batcher(500)
    batcher.add_withheld("ann", "contact")
    batcher.add_kept(kept(1, 100), 0)
    first = batcher.add_kept(kept(2, 700), 0)
    assert [clip.withheld for clip in first] == [(("contact", 1),)]
    assert [clip.withheld for clip in batcher.flush()] == [()]
    batcher.add_withheld("ann", "occluded")
    (clip,) = batcher.flush()
    assert (clip.frames, clip.withheld) == ((), (("occluded", 1),))


def test_the_clock_closes_the_clip_of_who_went_away_and_makes_none_without_pictures() -> None:
    batcher = Batcher(500)
    batcher.add_kept(kept(0, 400), 1_000)
    assert batcher.close_idle(1_499) == []
    assert sequences(batcher.close_idle(1_500)) == [[0]]
    assert batcher.close_idle(9_999) == []
    batcher.add_withheld("ann", "contact")
    assert batcher.close_idle(10**6) == []


def test_what_waits_for_somebody_who_said_no_is_dropped_and_nothing_of_another() -> None:
    batcher = Batcher(500)
    batcher.add_kept(kept(0, 0, "ann"), 0)
    batcher.add_withheld("ann", "contact", 3)
    batcher.add_kept(kept(0, 0, "bob"), 0)
    assert [frame.sequence for frame in batcher.drop("ann")] == [0]
    assert batcher.drop("ann") == []
    assert {clip.alias: clip.withheld for clip in batcher.flush()} == {"bob": ()}


@pytest.mark.parametrize("clip_ms", [0, 1, 100, 500, 2_000])
def test_no_frame_is_lost_or_doubled_and_order_is_kept(clip_ms: int) -> None:
    batcher = Batcher(clip_ms)
    times = [0, 33, 66, 900, 901, 902, 5_000, 5_400, 5_500, 5_501]
    closed = [clip for number, at_ms in enumerate(times) for clip in batcher.add_kept(kept(number, at_ms), 0)]
    closed += batcher.flush()
    assert [frame.sequence for clip in closed for frame in clip.frames] == list(range(len(times)))
    assert all(clip.frames[-1].captured_at_ms - clip.frames[0].captured_at_ms <= clip_ms for clip in closed)
