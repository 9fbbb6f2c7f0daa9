"""What the wallet writes of other senses: checked files, and nothing of what is damaged."""

from __future__ import annotations

import json
import wave
from io import BytesIO
from pathlib import Path

import msgspec
import numpy as np
import pytest

from clients.sdk.new_files import write_private
from clients.sdk.pictures.rendition_files import sense_file
from clients.sdk.pictures.rendition_picture import decode_depth_png, encode_depth_png
from clients.wallet.records.picture_files import delete_frames, write_frames
from clients.wallet.records.viewing import FrameView
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


def own_box(number: int) -> FrameView:
    box = encode_depth_png(np.full((4, 3), 900 + number, dtype=np.uint16))
    return FrameView(number, "ok", Rendition(1, 5, number, 8, 6, 2, 1, 3, 4, b"\x01" * 32, "png16", box))


async def test_on_a_frame_that_was_withdrawn_the_person_is_shown_alone(tmp_path: Path) -> None:
    asked = []

    async def withdrawn(rendition: Rendition) -> bytes | None:
        asked.append(rendition.background_id)

    shown: list[int] = []
    written = await write_frames(
        withdrawn, bytes(16), [own_box(0), own_box(1)], tmp_path, lambda number, *_rest: shown.append(number)
    )
    assert asked == [b"\x01" * 32], "it is asked for once"
    assert shown == [1, 2]
    whole = decode_depth_png(next(path for path in written if path.name.endswith(".depth.png")).read_bytes())
    assert np.count_nonzero(whole) == 12


def test_a_picture_over_a_file_that_others_could_read_is_for_its_owner_alone(tmp_path: Path) -> None:
    path = tmp_path / "frame-0.png"
    path.write_bytes(b"of an earlier look")
    path.chmod(0o644)
    write_private(path, b"picture")
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"picture", 0o600)


async def test_no_picture_is_written_or_deleted_through_a_link(tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "pics", tmp_path / "elsewhere"
    record, mine = out / bytes(16).hex(), elsewhere / "picture-0001.frame-00000000.png"
    for folder in (out, elsewhere):
        folder.mkdir()
    mine.write_bytes(b"mine")
    record.symlink_to(elsewhere, target_is_directory=True)
    for _ in range(2):
        with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
            await write_frames(no_room, bytes(16), [own_box(0)], out)
        with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
            delete_frames(record)
        record.unlink()
        record.touch()
    record.unlink()
    record.mkdir()
    (record / mine.name).symlink_to(mine)
    with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
        await write_frames(no_room, bytes(16), [own_box(0)], out)
    assert (list(elsewhere.iterdir()), mine.read_bytes()) == ([mine], b"mine")


async def no_room(_rendition: Rendition) -> bytes | None:
    return None
