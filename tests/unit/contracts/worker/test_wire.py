"""Frames in a pipe: whole or not at all, and nothing that is not of the protocol."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

import msgspec
import pytest

from consensus.chain.block import ContractEvent, Receipt
from contracts.worker.system_calls import build_filter
from contracts.worker.wire import FROM_NODE, FROM_WORKER, Executed, Get, Hello, Pipe, Rows, SandboxFeature, Value, pack


@pytest.fixture
def pipe() -> Iterator[tuple[Pipe, int]]:
    """A pipe that reads what it writes, and its writing end."""
    reading, writing = os.pipe()
    yield Pipe(reading, writing), writing
    os.close(reading)
    with contextlib.suppress(OSError):  # a test may have closed it
        os.close(writing)


def test_every_message_comes_out_as_it_went_in(pipe: tuple[Pipe, int]) -> None:
    receipt = Receipt(b"t" * 32, True, "OK", "", None, 7, (ContractEvent("records", "made", b"\x80"),))
    executed = Executed((receipt,), {b"k": b"v", b"gone": None}, {b"": b"page"}, b"r" * 32, b"q" * 32, 7, (b"l",), 4, 2)
    for message in (executed, Get(b"key"), Hello((SandboxFeature("limits", False, "why"),))):
        pipe[0].send(message)
        assert pipe[0].receive(FROM_WORKER) == message
    for message in (Value(None), Value(b""), Rows([(b"a", b"b")])):
        pipe[0].send(message)
        assert pipe[0].receive(FROM_NODE) == message


def test_what_only_the_other_side_may_say_and_a_frame_cut_short_are_refused(pipe: tuple[Pipe, int]) -> None:
    pipe[0].send(Value(b"x"))
    with pytest.raises(msgspec.ValidationError):
        pipe[0].receive(FROM_WORKER)
    os.write(pipe[1], pack(Get(b"key"))[:-1])
    os.close(pipe[1])
    with pytest.raises(EOFError):
        pipe[0].receive(FROM_WORKER)


@pytest.mark.parametrize("frame", [b"\xff\xff\xff\xff", b"\0\0\0\1\xc1", b"\0\0\0\2\x91\xa5", bytes(4)])
def test_nonsense_is_refused_before_it_is_believed(pipe: tuple[Pipe, int], frame: bytes) -> None:
    os.write(pipe[1], frame)
    with pytest.raises(msgspec.MsgspecError):
        pipe[0].receive(FROM_WORKER)


def test_the_filter_is_known_for_the_usual_machines_and_for_no_other() -> None:
    for machine in ("x86_64", "aarch64"):
        code = build_filter(machine)
        assert code is not None
        assert len(code) % 8 == 0
    assert build_filter("x86_64") != build_filter("aarch64")
    assert build_filter("pdp11") is None
