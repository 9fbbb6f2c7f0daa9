"""Draws a process map with Graphviz, where `dot` is installed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from consensus.errors import BlockRobotError

GRAPHVIZ_PROGRAM = "dot"
DRAWING_MAX_S = 60.0
PICTURE_FORMS: dict[str, tuple[str, ...]] = {"svg": (), "png": ("-Gdpi=160",)}  # a PNG is to be sharp on paper too


def write_dot(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")


def draw_with_graphviz(dot_file: Path) -> list[Path]:
    """Draw a DOT file as SVG and PNG beside it; return their paths.

    Raises DRAWING_UNAVAILABLE without `dot` or if it fails; the DOT file stays.
    """
    program = shutil.which(GRAPHVIZ_PROGRAM)
    if program is None:
        raise BlockRobotError(
            "DRAWING_UNAVAILABLE", f"Graphviz's `{GRAPHVIZ_PROGRAM}` is not installed here; {dot_file.name} is written."
        )
    pictures = []
    for form, options in PICTURE_FORMS.items():
        picture = dot_file.with_suffix(f".{form}")
        command = [program, f"-T{form}", "-o", str(picture), *options, str(dot_file)]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=DRAWING_MAX_S)
        except (OSError, subprocess.SubprocessError) as error:
            picture.unlink(missing_ok=True)
            raise BlockRobotError(
                "DRAWING_UNAVAILABLE",
                f"`{GRAPHVIZ_PROGRAM} -T{form}` failed on {dot_file.name}: {type(error).__name__}.",
            ) from None
        pictures.append(picture)
    return pictures
