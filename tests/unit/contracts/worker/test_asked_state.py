"""What a worker asks of its node follows what contracts take, and pay for, of the rows."""

from __future__ import annotations

from itertools import islice
from typing import Any, cast

import pytest

from contracts.execution.call_host import CallHost
from contracts.state.view import MemoryState
from contracts.worker import process
from contracts.worker.process import RemoteState
from contracts.worker.wire import Get, Pipe, Rows, Scan, Value

GROUPS, ROWS = 20, 64
VALUE = b"\xc4" + bytes(4_000)
STATE = MemoryState()
STATE.apply({b"it\x00%02d-%02d" % (group, row): VALUE for group in range(GROUPS) for row in range(ROWS)})


class CountingPipe:
    """Answers as a node does, and counts."""

    def __init__(self) -> None:
        self.questions = 0
        self.carried_bytes = 0
        self._question: Any = None

    def send(self, question: Any) -> None:
        self.questions += 1
        self._question = question

    def receive(self, _: Any) -> Rows | Value:
        question = self._question
        if isinstance(question, Get):
            value = STATE.get(question.key)
            self.carried_bytes += len(value or b"")
            return Value(value)
        assert isinstance(question, Scan)
        rows = list(islice(STATE.scan_range(question.start, question.end), question.limit))
        self.carried_bytes += sum(len(value) for _, value in rows)
        return Rows(rows)


@pytest.mark.parametrize("limit", [1, 3, ROWS])
def test_scans_carry_about_twice_what_is_taken_at_most(limit: int) -> None:
    pipe = CountingPipe()
    host = CallHost(RemoteState(cast(Pipe, pipe), b""))
    host.begin()
    for group in range(GROUPS):
        prefix = b"it\x00%02d" % group
        assert host.scan(prefix, limit) == list(STATE.scan(prefix, limit))

    assert pipe.carried_bytes <= 2 * GROUPS * limit * len(VALUE)
    assert pipe.questions <= GROUPS * (limit.bit_length() + 1)


def test_a_value_that_is_kept_no_more_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = CountingPipe()
    monkeypatch.setattr(process, "ASKED_KEPT_MAX_BYTES", 3 * len(VALUE))
    state = RemoteState(cast(Pipe, pipe), b"")
    rows = list(state.scan(b"it\x00", 2 * ROWS))
    questions = pipe.questions
    assert state.get(rows[-1][0]) == VALUE
    assert pipe.questions == questions
    assert all(state.get(key) == value for key, value in rows)
    assert pipe.questions > questions
