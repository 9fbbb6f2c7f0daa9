"""Colour that was stored elsewhere: whole and fitting it is shown, anything else is refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from clients.sdk.pictures.depth_colours import UNMEASURED_GREY
from clients.sdk.pictures.rendition_picture import check_jpeg, encode_depth_png, paint_colour
from consensus.errors import BlockRobotError

OWN = np.zeros((4, 5, 4), np.uint8)
OWN[1:3, 1:3] = (10, 20, 200, 255)  # blue, green, red, opaque


def packed(image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], suffix: str = ".png") -> bytes:
    done, data = cv2.imencode(suffix, image)
    assert done
    return bytes(data.tobytes())


PNG = packed(OWN)
JPEG = packed(np.full((8, 12, 3), 90, np.uint8), ".jpg")


def test_only_the_owners_pixels_show_and_the_rest_is_grey() -> None:
    whole = np.asarray(cv2.imdecode(np.frombuffer(paint_colour(20, 10, (3, 2, 5, 4), PNG), np.uint8), cv2.IMREAD_COLOR))
    assert whole.shape == (10, 20, 3)
    assert whole[3, 4].tolist() == [10, 20, 200]
    whole[3:5, 4:6] = UNMEASURED_GREY
    assert (whole == UNMEASURED_GREY).all()


@pytest.mark.parametrize("box", [(16, 2, 5, 4), (3, 7, 5, 4), (-1, 0, 5, 4), (0, 0, 4, 5), (0, 0, 0, 0)])
def test_a_box_that_does_not_fit_is_corrupted(box: tuple[int, int, int, int]) -> None:
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        paint_colour(20, 10, box, PNG)


@pytest.mark.parametrize("place", range(0, len(PNG), 3))
def test_any_changed_byte_is_noticed(place: int) -> None:
    changed = bytearray(PNG)
    changed[place] ^= 0x41
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        paint_colour(20, 10, (3, 2, 5, 4), bytes(changed))


def test_a_picture_of_another_kind_is_corrupted() -> None:
    for png in (packed(OWN[..., :3].copy()), encode_depth_png(np.ones((4, 5), np.uint16)), b"", JPEG):
        with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
            paint_colour(20, 10, (3, 2, 5, 4), png)


def test_a_whole_jpeg_is_taken_as_it_is() -> None:
    assert check_jpeg(JPEG, 12, 8) == JPEG


@pytest.mark.parametrize(
    ("data", "width", "height"),
    [
        (JPEG, 8, 12),
        (JPEG, 12, 9_000),
        (JPEG[:-1], 12, 8),
        (JPEG[:40] + b"\xff\xd9", 12, 8),
        (PNG, 5, 4),
        (b"\xff\xd8\xff\xd9", 1, 1),
        (packed(np.full((8, 12), 90, np.uint8), ".jpg"), 12, 8),
    ],
)
def test_what_is_no_such_jpeg_is_corrupted(data: bytes, width: int, height: int) -> None:
    with pytest.raises(BlockRobotError, match="RENDITION_CORRUPTED"):
        check_jpeg(data, width, height)
