"""What a block's calls see of each other, and that no scan pays again for what is not there any more."""

from __future__ import annotations

import pytest

from contracts.execution.call_host import CallHost
from contracts.state.view import MemoryState, Overlay


class CountedState(MemoryState):
    """A state in memory that counts the rows that are read by scans."""

    rows_read = 0

    def scan_range(self, start, end):
        for row in super().scan_range(start, end):
            self.rows_read += 1
            yield row


def key(number: int) -> bytes:
    return b"it\x00%06d" % number


@pytest.fixture
def state():
    made = CountedState()
    made.apply({key(number): b"v" for number in range(2_000)} | {b"it\x00x": b"live", b"other\x00": b"o"})
    return made


def wipe(host: CallHost, numbers) -> None:
    host.begin()
    for number in numbers:
        host.delete(key(number))
    host.keep()


def test_what_earlier_calls_of_the_block_deleted_is_passed_once(state):
    host = CallHost(state)
    for first in range(0, 2_000, 200):
        wipe(host, range(first, first + 200))
    for _ in range(50):
        host.begin()
        assert host.scan(b"it\x00", 1) == [(b"it\x00x", b"live")]
    for number in range(0, 2_000, 10):
        assert host.scan(key(number), 1) == []
    assert state.rows_read == 2_001


def test_what_is_deleted_between_two_scans_is_not_passed_again(state):
    host = CallHost(state)
    for number in range(500):
        wipe(host, [number])
        assert host.scan(b"it\x00", 1) == [(key(number + 1), b"v")]
    assert state.rows_read <= 502


def test_what_blocks_below_deleted_is_passed_once(state):
    view = Overlay.apply(state, {key(number): None for number in range(0, 2_000, 2)})
    view = Overlay.apply(view, {key(number): None for number in range(1, 2_000, 2)})
    host = CallHost(view)
    for limit in (1, 2, 3) * 20:
        assert host.scan(b"it\x00", limit) == [(b"it\x00x", b"live")]
    assert state.rows_read == 2_001


def test_a_scan_reads_no_more_than_it_returns(state):
    view = Overlay.apply(Overlay.apply(state, {key(number): None for number in range(5, 1_000)}), {key(1): b"new"})
    host = CallHost(view)
    host.put(key(0), b"mine")
    assert host.scan(b"it\x00", 3) == [(key(0), b"mine"), (key(1), b"new"), (key(2), b"v")]
    assert state.rows_read <= 4


def test_a_range_that_ends_among_deleted_keys_ends_there(state):
    view = Overlay.apply(state, {key(number): None for number in range(2_000)})
    host = CallHost(view)
    for number in range(2_000):
        assert host.scan(key(number), 1) == []
    assert state.rows_read <= 2_000


def test_a_call_that_failed_leaves_nothing_for_the_next_scan(state):
    host = CallHost(state)
    host.begin()
    host.delete(key(0))
    host.put(b"it\x00000000a", b"a")
    assert host.scan(b"it\x00", 1) == [(b"it\x00000000a", b"a")]
    host.begin()
    assert host.scan(b"it\x00", 2) == [(key(0), b"v"), (key(1), b"v")]


def test_what_comes_and_goes_over_several_calls(state):
    host = CallHost(state)
    for value in (b"one", None, b"two"):
        host.begin()
        host.delete(key(0)) if value is None else host.put(key(0), value)
        expected = [(key(0), value)] if value else []
        assert host.scan(key(0), 5) == expected
        host.keep()
        host.begin()
        assert host.scan(key(0), 5) == expected
