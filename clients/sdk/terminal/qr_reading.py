"""QR reader process for one picture on standard input; isolated since decoding time is unbounded."""

from __future__ import annotations

import itertools
import json
import resource
import sys
from io import BytesIO

import cv2
import numpy as np
from PIL import Image

from clients.sdk.pictures.picture_guard import JPEG_SIGNATURE, has_few_scans
from clients.sdk.terminal.qr_codes import TOO_MUCH

MEMORY_MAX_BYTES = 3 * 1024**3
"""Of addresses. The largest picture that is decoded takes 1.1 GiB."""
PICTURE_SIDE_MAX_PX = 8_192
READ_SIDE_MAX_PX = 1_600
_PICTURES = ("PNG", "JPEG", "WEBP", "BMP", "GIF")


class NoPictureError(Exception):
    """The input is not a usable picture."""


def find_text(data: bytes) -> str:
    if data.startswith(JPEG_SIGNATURE) and not has_few_scans(data):
        raise NoPictureError("The picture asks for more work than its pixels need.")
    try:
        with Image.open(BytesIO(data), formats=_PICTURES) as opened:
            if max(opened.size) > PICTURE_SIDE_MAX_PX:
                raise NoPictureError(f"The picture is wider than {PICTURE_SIDE_MAX_PX} pixels.")
            opened.thumbnail((READ_SIDE_MAX_PX, READ_SIDE_MAX_PX))
            grey = np.asarray(opened.convert("L"), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        raise NoPictureError("The file is no picture that can be read.") from None
    tries = (grey, cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST), 255 - grey)
    for pixels, make in itertools.product(tries, (cv2.QRCodeDetector, cv2.QRCodeDetectorAruco)):
        try:  # the first detector is better at photographs, and misses one drawn code in a hundred
            text, _, _ = make().detectAndDecode(np.asarray(pixels, dtype=np.uint8))
        except cv2.error:
            continue
        if text:
            return str(text)
    return ""


def _limit_process(cpu_max_s: int) -> None:
    """In time, memory, files and core dumps."""
    for what, most in (
        (resource.RLIMIT_CPU, cpu_max_s),
        (resource.RLIMIT_AS, MEMORY_MAX_BYTES),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(what)
        try:
            resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
        except (OSError, ValueError):  # macOS bounds no addresses
            if what != resource.RLIMIT_AS:
                raise


def main() -> int:
    """Print JSON with the `text`, or the error's `detail`. The argument is how many seconds of a processor it may take."""
    _limit_process(int(sys.argv[1]))
    cv2.setNumThreads(1)
    try:
        answer = {"text": find_text(sys.stdin.buffer.read())}
    except NoPictureError as error:
        answer = {"detail": str(error)}
    except MemoryError:
        answer = {"detail": TOO_MUCH}
    sys.stdout.write(json.dumps(answer))
    return 0


if __name__ == "__main__":
    sys.exit(main())
