"""QR codes: what is drawn is read again, from a screen, from paper and from a poor photograph."""

from __future__ import annotations

import re
import resource
import time
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image

from clients.sdk.terminal import qr_codes
from clients.sdk.terminal.qr_codes import PICTURE_MAX_BYTES, qr_columns, qr_lines, qr_svg, read_given, read_qr
from clients.sdk.terminal.qr_reading import find_text
from consensus.errors import BlockRobotError

CODE = "BR1-" + "ABCDEFGHIJKLMNOPQRSTUVWXYZ234567" * 7
_CELL = re.compile(r"M(\d+) (\d+)h1v1h-1z")


def drawn(svg: str, cell_px: int = 4) -> Image.Image:
    """Paint the squares of a code's SVG."""
    side = int(re.search(r'viewBox="0 0 (\d+)', svg)[1])  # type: ignore[index]
    picture = np.full((side, side), 255, np.uint8)
    for x, y in _CELL.findall(svg):
        picture[int(y), int(x)] = 0
    return Image.fromarray(picture).resize((side * cell_px, side * cell_px), Image.Resampling.NEAREST)


def packed(picture: Image.Image, kind: str = "PNG") -> bytes:
    out = BytesIO()
    picture.save(out, kind)
    return out.getvalue()


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_what_a_page_shows_is_read(kind: str) -> None:
    assert read_qr(packed(drawn(qr_svg(CODE)), kind)) == CODE


@example("2222333222322333N222222233OL7223222222HN23D3L2223263C2H2353A222A33A")
@given(st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ234567", min_size=40, max_size=220))
def test_every_code_comes_back(letters: str) -> None:
    assert find_text(packed(drawn(qr_svg(f"BR1-{letters}")))) == f"BR1-{letters}"


def test_what_a_terminal_shows_is_read() -> None:
    lines = qr_lines(CODE).plain.split("\n")
    assert {len(line) for line in lines} == {qr_columns(CODE)}
    assert len(lines) <= 40, "it fits on a screen"
    halves = {" ": (255, 255), "▀": (0, 255), "▄": (255, 0), "█": (0, 0)}
    rows = [[halves[cell][half] for cell in line] for line in lines for half in (0, 1)]
    picture = Image.fromarray(np.array(rows, np.uint8))
    assert read_qr(packed(picture.resize((picture.width * 6, picture.height * 6), Image.Resampling.NEAREST))) == CODE


def test_a_photograph_is_read() -> None:
    """Turned, seen at an angle, unevenly lit, noisy and saved as JPEG."""
    flat = np.asarray(drawn(qr_svg(CODE), 9))
    side = flat.shape[0]
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)
    seen = np.array([[180, 130], [760, 90], [800, 720], [140, 690]], np.float32)
    photo = cv2.warpPerspective(flat, cv2.getPerspectiveTransform(corners, seen), (960, 820), borderValue=(190,))
    light = np.linspace(0.75, 1.0, 960)[None, :]
    noisy = photo * light + np.random.default_rng(5).normal(0, 6, photo.shape)
    assert read_qr(packed(Image.fromarray(np.clip(noisy, 0, 255).astype(np.uint8)), "JPEG")) == CODE


@pytest.mark.parametrize(
    "data",
    [b"", b"no picture", b"\x89PNG\r\n\x1a\n", packed(Image.new("L", (400, 400), 255)), b"x" * (PICTURE_MAX_BYTES + 1)],
    ids=["empty", "text", "torn", "blank", "too-large"],
)
def test_no_code_is_said_and_never_guessed(data: bytes) -> None:
    with pytest.raises(BlockRobotError, match=r"^QR_UNREADABLE:"):
        read_qr(data)


@pytest.mark.timeout(120)
def test_a_picture_full_of_finder_patterns_ends_with_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight kilobytes, for which the detector would work for minutes."""
    monkeypatch.setattr(qr_codes, "READING_CPU_MAX_S", 2)
    pattern = np.full((9, 9), 255, np.uint8)
    pattern[1:8, 1:8] = 0
    pattern[2:7, 2:7] = 255
    pattern[3:6, 3:6] = 0
    data = packed(Image.fromarray(np.kron(np.tile(pattern, (40, 40)), np.ones((4, 4), np.uint8))))
    assert len(data) < 10_000
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.process_time()
    with pytest.raises(BlockRobotError, match=r"QR_UNREADABLE.*more time or memory"):
        read_qr(data)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime - before.ru_utime < 4
    assert time.process_time() - began < 1, "nothing of it is done in this process"


@pytest.mark.timeout(60)
def test_a_reading_that_is_not_given_a_processor_ends_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qr_codes, "READING_MAX_S", 0.001)
    with pytest.raises(BlockRobotError, match=r"QR_UNREADABLE.*more time or memory"):
        read_qr(packed(drawn(qr_svg(CODE))))


def test_a_damaged_code_is_not_read_as_another() -> None:
    picture = np.asarray(drawn(qr_svg(CODE))).copy()
    side = picture.shape[0]
    picture[side // 3 : side, side // 3 : side] = 255
    with pytest.raises(BlockRobotError, match="QR_UNREADABLE"):
        read_qr(packed(Image.fromarray(picture)))


def test_a_code_is_given_as_letters_in_a_file_or_in_a_picture(tmp_path: Path) -> None:
    (tmp_path / "card.txt").write_text(f" {CODE}\n", encoding="utf-8")
    (tmp_path / "card.png").write_bytes(packed(drawn(qr_svg(CODE))))
    for given_code in (CODE, f"@{tmp_path}/card.txt", f"@{tmp_path}/card.png"):
        assert read_given(given_code) == CODE


@pytest.mark.parametrize("name", ["missing", "", "a\0b"])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(BlockRobotError, match=r"^FILE_UNUSABLE:"):
        read_given(f"@{tmp_path}/{name}")
