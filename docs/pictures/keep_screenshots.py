"""Keeps pictures of pages for the documentation: docs/pictures/NAME/*.png out of build/screenshots/NAME-*.png.

The pictures are taken by the tests in tests/ui, of real networks. Each is cut to the first screen, or a little more of a
narrow one, and reduced to 128 colours. Must never draw or retouch a page.

Run it from the root of the repository, after the tests of that page:
.venv/bin/python -m pytest tests/ui/test_explorer.py && .venv/bin/python docs/pictures/keep_screenshots.py explorer
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

TAKEN = Path(__file__).parents[2] / "build" / "screenshots"
WIDE_HEIGHT_PX = 1_000
NARROW_HEIGHT_PX = 1_300
COLOURS_COUNT = 128
PICTURE_MAX_BYTES = 150_000


def keep(path: Path, folder: Path, page: str) -> Path:
    """Write one picture, cut and reduced; return where it is. Fails if it is too large for the documentation."""
    with Image.open(path) as taken:
        height = NARROW_HEIGHT_PX if path.stem.endswith("-narrow") else WIDE_HEIGHT_PX
        cut = taken.convert("RGB").crop((0, 0, taken.width, min(taken.height, height)))
    kept = folder / f"{path.stem.removeprefix(page + '-')}.png"
    cut.quantize(COLOURS_COUNT, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(kept, optimize=True)
    size = kept.stat().st_size
    if size > PICTURE_MAX_BYTES:
        raise SystemExit(f"{kept} has {size} bytes")
    return kept


def main(names: list[str]) -> None:
    """Keep the pictures of the pages that are named."""
    for page in names:
        folder = Path(__file__).parent / page
        folder.mkdir(exist_ok=True)
        kept = [keep(path, folder, page) for path in sorted(TAKEN.glob(f"{page}-*.png"))]
        if not kept:
            raise SystemExit(f"There are no pictures of {page} in {TAKEN}: run its tests in tests/ui first.")
        for old in set(folder.glob("*.png")) - set(kept):
            old.unlink()
        sys.stdout.write(f"{len(kept)} pictures in {folder}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
