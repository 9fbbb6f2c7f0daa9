"""What the wallet writes of other senses: checked files, and nothing of what is damaged."""

from __future__ import annotations

import json
import wave
from io import BytesIO

import msgspec
import pytest

from clients.sdk.rendition_files import sense_file
from consensus.errors import BlockRobotError
from consensus.records.renditions import Rendition, decode_rendition, encode_rendition

LABEL = Rendition(1, 5, 7, 1, 1, 0, 0, 0, 0, bytes(32), "label", b'{"label": "calm", "confidence": 0.5}')


def sound(frames: int = 100) -> bytes:
    packed = BytesIO()
    with wave.open(packed, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8_000)
        file.writeframes(bytes(2 * frames))
    return packed.getvalue()


def changed(**fields: object) -> Rendition:
    return msgspec.structs.replace(LABEL, **fields)


def test_a_label_is_written_as_json() -> None:
    suffix, data = sense_file(LABEL)
    assert (suffix, json.loads(data)) == ("label.json", {"label": "calm", "confidence": 0.5})


def test_a_sound_is_written_as_it_is() -> None:
    assert sense_file(changed(encoding="wav", pixels=sound())) == ("wav", sound())


@pytest.mark.parametrize(
    "rendition",
    [
        changed(pixels=b"calm"),
        changed(pixels=b"[1]"),
        changed(pixels=b'{"label": 3}'),
        changed(pixels=b"\xff\xfe"),
        changed(pixels=b'{"label": "' + b"a" * 5_000 + b'"}'),
        changed(encoding="wav", pixels=b"RIFF"),
        changed(encoding="wav", pixels=sound()[:-3]),
        changed(encoding="wav", pixels=b"MThd" + bytes(60)),
        changed(encoding="jpeg", pixels=b"\xff\xd8\xff\xd9"),
        changed(encoding="png-rgba", pixels=b"\x89PNG"),
    ],
)
def test_what_is_damaged_is_refused(rendition: Rendition) -> None:
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        sense_file(rendition)


@pytest.mark.parametrize("encoding", ["png16", "png-rgba", "jpeg", "label", "wav"])
def test_every_encoding_survives_being_packed(encoding: str) -> None:
    rendition = changed(encoding=encoding)
    assert decode_rendition(encode_rendition(rendition)) == rendition


@pytest.mark.parametrize(
    "fields",
    [
        {"encoding": "gif"},
        {"encoding": ""},
        {"encoding": "label", "box_width": 1, "width": 4},
        {"encoding": "wav", "box_width": 1, "width": 4},
        {"version": 2},
        {"width": 0},
        {"encoding": "jpeg", "box_width": 2},
        {"captured_at_ms": 1 << 62},
        {"captured_at_ms": -1},
    ],
)
def test_an_encoding_a_time_or_a_box_that_no_wallet_knows_is_refused(fields: dict[str, object]) -> None:
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        decode_rendition(encode_rendition(changed(**fields)))
