"""The name of a picture's file says the picture's number in its record, which commands take, and the robot's frame."""

from __future__ import annotations

import pytest

from clients.sdk.pictures.picture_names import is_picture_name, name_picture, read_robot_frame


def test_a_name_begins_with_the_number_in_the_record_and_says_the_robots_frame_after_it() -> None:
    assert name_picture(4, 9, "depth.png") == "picture-0005.frame-00000009.depth.png"
    assert name_picture(12_344, 123_456_789, "wav") == "picture-12345.frame-123456789.wav"


@pytest.mark.parametrize("suffix", ["png", "depth.png", "rgb.png", "rgb.jpg", "label.json", "wav"])
def test_what_is_named_is_known_again_and_its_frame_read(suffix: str) -> None:
    name = name_picture(4, 9, suffix)
    assert is_picture_name(name)
    assert read_robot_frame(name) == 9


@pytest.mark.parametrize(
    "name",
    [
        "notes.txt",
        "picture-5.frame-9.png",
        "picture-0005.png",
        "picture-0005.frame-00000009.txt",
        "picture-0005.frame-00000009.png.bak",
        "my picture-0005.frame-00000009.png",
        "picture-٠٠٠٥.frame-00000009.png",
        "00000009.png",
    ],
)
def test_any_other_name_is_somebodys_own(name: str) -> None:
    assert not is_picture_name(name)
    with pytest.raises(ValueError, match="no picture's file"):
        read_robot_frame(name)
