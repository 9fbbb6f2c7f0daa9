"""Frames come out as they went in, however the stream is cut, and nothing over its limit is ever waited for."""

from __future__ import annotations

import random

import pytest

from consensus.errors import BlockRobotError
from node.p2p.wire import FRAME_MAX_BYTES, FrameDecoder, FrameKind, decode_request, encode_frame, encode_request


def test_frames_survive_any_cutting_of_the_stream() -> None:
    chance = random.Random(7)
    sent = [(chance.choice(list(FrameKind)), chance.randbytes(chance.randrange(60))) for _ in range(200)]
    stream = b"".join(encode_frame(kind, payload) for kind, payload in sent)
    decoder, received, position = FrameDecoder(), [], 0
    while position < len(stream):
        step = chance.randrange(1, 90)
        received += list(decoder.feed(stream[position : position + step]))
        position += step
    assert received == sent


def test_a_frame_over_the_limit_is_refused_before_its_bytes_came_and_not_sent_either() -> None:
    head = (FRAME_MAX_BYTES[FrameKind.VOTE] + 2).to_bytes(4, "big") + bytes([FrameKind.VOTE])
    with pytest.raises(BlockRobotError, match=r"^PEER_MESSAGE_INVALID:"):
        list(FrameDecoder().feed(head))
    with pytest.raises(BlockRobotError, match=r"^PEER_MESSAGE_INVALID:"):
        encode_frame(FrameKind.HEIGHT, bytes(FRAME_MAX_BYTES[FrameKind.HEIGHT] + 1))


@pytest.mark.parametrize("head", [b"\x00\x00\x00\x00\x03", b"\x00\x00\x00\x05\x63", b"GET / HTTP/1.1"])
def test_what_is_no_frame_is_refused(head: bytes) -> None:
    with pytest.raises(BlockRobotError, match=r"^PEER_MESSAGE_INVALID:"):
        list(FrameDecoder().feed(head))


def test_frames_before_a_bad_one_are_delivered_and_a_request_keeps_its_number_and_kind() -> None:
    frames = FrameDecoder().feed(encode_frame(FrameKind.VOTE, b"good") + b"\xff" * 8)
    assert next(frames) == (FrameKind.VOTE, b"good")
    with pytest.raises(BlockRobotError):
        next(frames)
    assert decode_request(encode_request(77, 3, b"body")) == (77, 3, b"body")
    with pytest.raises(BlockRobotError):
        decode_request(b"\x00\x00")


@pytest.mark.parametrize("kind", FrameKind)
def test_before_the_hello_nothing_else_is_waited_for(kind: FrameKind) -> None:
    decoder = FrameDecoder()
    decoder.take(encode_frame(kind, b"x")[:-1])
    if kind in {FrameKind.HELLO, FrameKind.REFUSAL}:
        assert decoder.next_frame(is_greeted=False) is None
        return
    with pytest.raises(BlockRobotError, match="before it said hello"):
        decoder.next_frame(is_greeted=False)
    assert decoder.next_frame() is None
