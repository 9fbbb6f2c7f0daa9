"""People marked by eye in some frames, independent of the robot's segmentation."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from clients.robot.sensing.sensor_events import Mask
from consensus.bounded_text import read_json_text

MARKED_FILE = "marked.json"
OWNER_MIN_SHARE = 0.8
"""Of a rendition's pixels: so many lie in its owner's box, or nobody can be named."""

VISIBLE_MIN_SHARE = 0.02
"""The share of a person's box in another's rendition, outside of the owner's box, from which on they are visible there."""

_SLACK_PX = 6  # the boxes were drawn by eye

Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class InPicture:
    """People in a rendition by index: owner (None: cannot be named) and others."""

    owner: int | None
    others: tuple[int, ...]


class _Marked(msgspec.Struct, frozen=True):
    film_sha256: str
    frames: dict[int, tuple[Box, ...]]


@lru_cache(maxsize=1)
def _marked() -> _Marked:
    text = (resources.files("network.lab.pedestrians") / MARKED_FILE).read_text(encoding="utf-8")
    return msgspec.convert(read_json_text(text), _Marked, str_keys=True)


def is_marked_film(film: Path) -> bool:
    with film.open("rb") as file:
        return bool(hashlib.file_digest(file, "sha256").hexdigest() == _marked().film_sha256)


def marked_people() -> dict[int, tuple[Box, ...]]:
    """Return each marked frame's boxes (x, y, width, height)."""
    return _marked().frames


def find_people(shown: Mask, people: tuple[Box, ...]) -> InPicture:
    inside = [_inside(shown.shape, box, _SLACK_PX) for box in people]
    total = max(1, int(np.count_nonzero(shown)))
    shares = [int(np.count_nonzero(shown & mask)) / total for mask in inside]
    best = max(range(len(people)), key=lambda number: shares[number])
    owner = best if shares[best] >= OWNER_MIN_SHARE else None
    rest = shown & ~inside[best] if owner is not None else shown
    others = tuple(
        number
        for number, box in enumerate(people)
        if number != owner
        and np.count_nonzero(rest & _inside(shown.shape, box, 0)) >= VISIBLE_MIN_SHARE * box[2] * box[3]
    )
    return InPicture(owner, others)


def _inside(shape: tuple[int, ...], box: Box, slack: int) -> npt.NDArray[np.bool_]:
    mask = np.zeros(shape, dtype=bool)
    left, top, width, height = box
    mask[max(0, top - slack) : top + height + slack, max(0, left - slack) : left + width + slack] = True
    return mask
