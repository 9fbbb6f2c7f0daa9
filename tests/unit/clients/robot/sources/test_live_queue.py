"""What waits for a robot that is busy: bounded, in order, and what there is no room for is counted."""

from __future__ import annotations

from clients.robot.sensing.sensor_events import RefusedMessage, Sighting
from clients.robot.sources.live.live_queue import ENTRY_BYTES, LiveQueue, Queued
from clients.robot.sources.messages.message_types import Message, MessageTypes, own_types

TYPES = MessageTypes(own_types(), ros1=True)


def entry(kind: str, number: int, size: int = 100) -> Queued:
    return Queued(kind, (Message(f"/{kind}", "a/msg/B", number, bytes(size)), TYPES))


def numbers(queue: LiveQueue) -> list[int]:
    found = []
    while (taken := queue.take()) is not None:
        assert isinstance(taken.what, tuple)
        found.append(taken.what[0].at_ns)
    return found


def test_what_came_is_taken_in_its_order_and_a_frame_finds_no_room_among_readings() -> None:
    queue = LiveQueue()
    for number, kind in enumerate(["frame", "sighting", "label", "frame", "audio", "sighting"]):
        queue.put(entry(kind, number))
    assert len(queue) == 6
    assert numbers(queue) == [0, 1, 2, 3, 4, 5]
    assert (queue.missed, queue.size_bytes) == ({}, 0)
    queue = LiveQueue(max_count=2)
    for number, kind in enumerate(["sighting", "sighting", "frame"]):
        queue.put(entry(kind, number))
    assert queue.missed == {"frame": 1}
    assert numbers(queue) == [0, 1]


def test_the_oldest_frames_go_first_then_sound_and_labels_and_readings_last() -> None:
    queue = LiveQueue(max_count=4)
    for number, kind in enumerate(["sighting", "frame", "label", "rgb", "frame", "sighting"]):
        queue.put(entry(kind, number))
    assert queue.missed == {"frame": 1, "rgb": 1}
    for number in range(6, 9):
        queue.put(entry("sighting", number))
    assert queue.missed == {"frame": 2, "rgb": 1, "label": 1, "sighting": 1}
    assert numbers(queue) == [5, 6, 7, 8]


def test_bytes_are_bounded_and_one_message_that_is_larger_is_dropped_alone() -> None:
    queue = LiveQueue(max_bytes=10 * (ENTRY_BYTES + 1000))
    for number in range(30):
        queue.put(entry("frame", number, 1000))
    assert queue.missed == {"frame": 20}
    assert numbers(queue) == list(range(20, 30))
    queue.put(entry("sighting", 1))
    queue.put(entry("frame", 2, 1 << 20))
    assert numbers(queue) == [1]


def test_who_waits_is_woken_once_and_by_the_next_that_comes_only() -> None:
    queue, woken = LiveQueue(), []
    queue.put(entry("frame", 0))
    assert queue.take(lambda: woken.append("early")) is not None
    assert queue.take(lambda: woken.append("now")) is None
    queue.put(Queued("sighting", Sighting(1, 1, "E1")))
    queue.put(Queued("sighting", RefusedMessage(1, "sighting", "field")))
    assert woken == ["now"]


def test_what_is_left_at_the_end_is_told_by_kind_and_shows_no_uid() -> None:
    queue = LiveQueue()
    for number in range(3):
        queue.put(entry("frame", number))
    queue.put(Queued("sighting", Sighting(1, 1, "E1")))
    assert queue.clear() == {"frame": 3, "sighting": 1}
    assert (len(queue), queue.size_bytes, queue.take()) == (0, 0, None)
    assert "E2001" not in repr(Queued("sighting", Sighting(1, 1, "E2001")))
    assert "E2001" not in repr(Queued("sighting", (Message("/tags", "a/msg/B", 0, b"E2001"), TYPES)))
