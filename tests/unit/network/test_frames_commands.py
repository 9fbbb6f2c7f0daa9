"""`blockrobot frames` refuses what names no frame or no robot before it asks a network for anything."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from clients.sdk.chain.empty_frames import PREVIEW_FILE
from clients.sdk.pictures.rendition_picture import (
    colourise,
    decode_colour_png,
    draw_preview,
    encode_depth_png,
)
from consensus.errors import BlockRobotError
from network.cli.main import main
from tests.unit.consensus.records.test_png import picture

MEMBER = "02" * 33


def call(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["frames", *map(str, arguments), "--json"])


def code_of(result: Result) -> str:
    return str(json.loads(result.stdout)["error"]["code"])


def test_it_must_be_known_whose_pictures_they_are_and_that_they_are_some(tmp_path: Path) -> None:
    assert code_of(call("approve", tmp_path, "--robot", MEMBER, "--yes")) == "BACKGROUND_NOT_FOUND"
    (tmp_path / "preview.png").write_bytes(picture())
    assert code_of(call("approve", tmp_path, "--robot", MEMBER, "--yes")) == "BACKGROUND_NOT_FOUND"
    (tmp_path / "000.png").write_bytes(b"no picture")
    assert code_of(call("approve", tmp_path, "--robot", MEMBER, "--yes")) == "BACKGROUND_NOT_A_PICTURE"
    (tmp_path / "000.png").write_bytes(picture())
    assert "--robot MEMBER_KEY" in call("approve", tmp_path, "--yes").output
    (tmp_path / "robot.txt").write_bytes(b"\xff\xfe")
    assert "66 hexadecimal digits" in call("approve", tmp_path, "--yes").output


def test_nobody_approves_unasked(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "000.png").write_bytes(picture())
    refused = call("approve", folder, "--robot", MEMBER, "--dir", tmp_path / "nowhere")
    assert refused.exit_code == 2
    assert "give --yes" in refused.output
    assert code_of(call("approve", folder, "--robot", MEMBER, "--yes", "--dir", tmp_path / "nowhere")) == (
        "CLUSTER_NOT_RUNNING"
    )


def test_what_is_approved_is_what_the_preview_shows(tmp_path: Path) -> None:
    """A robot, or whoever writes into its folder, leaves a harmless preview beside another picture."""
    folder, elsewhere = tmp_path / "frames", tmp_path / "a file of the admin"
    folder.mkdir()
    elsewhere.write_text("hers")
    asked = ("approve", folder, "--robot", MEMBER, "--dir", tmp_path / "nowhere")
    (folder / "000.png").write_bytes(encode_depth_png(np.full((8, 8), 2_000, np.uint16)))
    assert code_of(call(*asked, "--yes")) == "BACKGROUND_PREVIEW_DIFFERS", "there is none"
    (folder / PREVIEW_FILE).symlink_to(elsewhere)
    assert code_of(call(*asked)) == "FILE_EXISTS"
    assert elsewhere.read_text() == "hers"
    (folder / PREVIEW_FILE).unlink()
    for _ in range(2):
        assert "drawn just now" in call(*asked).output
    assert code_of(call(*asked, "--yes")) == "CLUSTER_NOT_RUNNING"
    (folder / "000.png").write_bytes(encode_depth_png(np.full((8, 8), 3_000, np.uint16)))
    assert code_of(call(*asked, "--yes")) == "BACKGROUND_PREVIEW_DIFFERS", "the frame was exchanged since"
    assert code_of(call(*asked)) == "FILE_EXISTS", "a picture that no robot left there is somebody's"
    (folder / "robot.txt").write_text(MEMBER)
    assert "drawn just now" in call(*asked).output


def test_a_preview_shows_every_frame_whole_and_large_ones_are_approved_in_parts() -> None:
    frames = [np.full((4 + number, 300), 1_000 + 100 * number, np.uint16) for number in range(9)]
    preview = decode_colour_png(draw_preview([encode_depth_png(frame) for frame in frames]))
    assert preview.shape[:2] >= (2 * 12, 8 * 300)
    for number, frame in enumerate(frames):
        top, left = number // 8 * 12, number % 8 * 300
        shown = preview[top : top + frame.shape[0], left : left + 300]
        assert np.array_equal(shown, decode_colour_png(colourise(frame, legend=False)))
    large = encode_depth_png(np.zeros((4096, 4096), np.uint16))
    with pytest.raises(BlockRobotError, match="in parts"):
        draw_preview([large] * 5)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("list", "02"), "66 hexadecimal digits"),
        (("list", "zz" * 33), "66 hexadecimal digits"),
        (("withdraw", MEMBER), "--all"),
        (("withdraw", MEMBER, "aa" * 32, "--all"), "--all"),
        (("withdraw", MEMBER, "aa"), "64 hexadecimal digits"),
    ],
)
def test_what_names_no_robot_or_frame_is_a_usage_error(arguments: tuple[str, ...], told: str) -> None:
    result = call(*arguments)
    assert result.exit_code == 2
    assert told in result.output
