"""QR codes: drawn for terminals and pages, read from pictures."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import segno
from rich.text import Text

from consensus.bounded_text import read_json_as
from consensus.errors import BlockRobotError

PICTURE_MAX_BYTES = 16 * 1024 * 1024
READING_CPU_MAX_S = 10
"""Of a processor. A photograph takes a second or two of a slow machine."""
READING_MAX_S = 60.0
"""For a machine that is busy."""
TEXT_FILE_MAX_BYTES = 4_096
_QUIET_MODULES = 4
_HALVES = {(False, False): " ", (True, False): "▀", (False, True): "▄", (True, True): "█"}
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
_NO_PROCESS = "The process that looks at pictures does not run here."
TOO_MUCH = "To look for a code in this picture takes more time or memory than any photograph needs."


def _matrix(text: str) -> list[list[bool]]:
    return [[bool(cell) for cell in row] for row in segno.make_qr(text, error="m").matrix_iter(border=_QUIET_MODULES)]


def qr_lines(text: str) -> Text:
    """Two rows per line, black on white."""
    rows = _matrix(text)
    if len(rows) % 2:
        rows.append([False] * len(rows[0]))
    pairs = zip(rows[::2], rows[1::2], strict=True)
    lines = ["".join(_HALVES[upper, lower] for upper, lower in zip(*pair, strict=True)) for pair in pairs]
    return Text("\n".join(lines), style="black on white", no_wrap=True)


def qr_columns(text: str) -> int:
    return len(_matrix(text))


def qr_svg(text: str) -> str:
    """Draw a scalable SVG element."""
    rows = _matrix(text)
    cells = "".join(f"M{x} {y}h1v1h-1z" for y, row in enumerate(rows) for x, cell in enumerate(row) if cell)
    side = len(rows)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {side} {side}" shape-rendering="crispEdges" role="img" '
        f'aria-label="QR"><path fill="#fff" d="M0 0h{side}v{side}H0z"/><path fill="#000" d="{cells}"/></svg>\n'
    )


def read_qr(data: bytes) -> str:
    """Read a picture's QR code (PNG, JPEG, WebP, BMP, GIF) in a separate process. Raises QR_UNREADABLE."""
    if len(data) > PICTURE_MAX_BYTES:
        raise BlockRobotError("QR_UNREADABLE", f"The picture has more than {PICTURE_MAX_BYTES >> 20} MiB.")
    command = [sys.executable, "-I", "-m", "clients.sdk.terminal.qr_reading", str(READING_CPU_MAX_S)]
    try:
        done = subprocess.run(
            command, input=data, capture_output=True, check=False, cwd="/", env=_ONE_THREAD, timeout=READING_MAX_S
        )
    except subprocess.TimeoutExpired:
        raise BlockRobotError("QR_UNREADABLE", TOO_MUCH) from None
    except OSError as error:
        raise BlockRobotError("QR_UNREADABLE", _NO_PROCESS) from error
    if done.returncode != 0:
        raise BlockRobotError("QR_UNREADABLE", TOO_MUCH if done.returncode < 0 else _NO_PROCESS)
    answer = read_json_as(done.stdout, dict[str, str])
    if not answer.get("text"):
        raise BlockRobotError("QR_UNREADABLE", answer.get("detail", ""))
    return answer["text"]


def read_given(given: str) -> str:
    """Return the text, or for `@FILE` its text or QR code. Raises FILE_UNUSABLE, QR_UNREADABLE."""
    if not given.startswith("@"):
        return given
    try:
        with Path(given[1:]).expanduser().open("rb") as file:
            data = file.read(PICTURE_MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "no such name"
        raise BlockRobotError("FILE_UNUSABLE", f"{given[1:]}: {reason}.") from None
    try:
        text = data.decode("utf-8") if len(data) <= TEXT_FILE_MAX_BYTES else ""
    except UnicodeDecodeError:
        text = ""
    return text.strip() or read_qr(data)
