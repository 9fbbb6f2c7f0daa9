"""A record's frames: committed bytes and their rendered pictures."""

from __future__ import annotations

import struct
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
import numpy.typing as npt

from clients.bundle.documents import FrameDocument, RecordOpening, read_bytes
from clients.bundle.layout import RECORD_OPENINGS, background_name, rendition_name, shown_name
from clients.sdk.pictures.depth_colours import Depth, colour_pixels
from clients.sdk.pictures.picture_guard import PNG_SIGNATURE
from clients.sdk.pictures.rendition_files import own_depth, sense_file
from clients.sdk.pictures.rendition_picture import (
    compose_on,
    decode_colour_png,
    decode_depth_png,
    encode_colour_png,
    encode_depth_png,
)
from consensus.errors import BlockRobotError
from consensus.limits import CLIP_FRAMES_MAX_COUNT
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256
from consensus.records.commitments import commitment_leaf, commitment_root
from consensus.records.renditions import ENCODING_PNG16, Rendition, decode_rendition
from consensus.state.records import RecordRow

PICTURE = "picture"
NOTICE = "notice"
UNDRAWABLE = "undrawable"
ERASED = "erased"
ABSENT = "absent"
_CHUNKS = frozenset((b"IHDR", b"IDAT", b"IEND"))


class FrameSource(Protocol):
    """Committed and empty frames, from memory or bundle."""

    def committed(self, name: str, record_id: bytes, index: int) -> bytes:
        """Raises BUNDLE_INVALID."""
        ...

    def background(self, digest: bytes) -> bytes | None: ...


Pixels = npt.NDArray[np.uint8] | Depth


@dataclass(frozen=True, slots=True)
class Piece:
    """One bundle file: bytes, or pixels packed as PNG."""

    name: str
    made: bytes | Pixels
    is_drawn: bool

    @property
    def content(self) -> bytes:
        if isinstance(self.made, bytes):
            return self.made
        if self.made.ndim == 2:
            return encode_depth_png(np.asarray(self.made, dtype=np.uint16))
        return encode_colour_png(np.asarray(self.made, dtype=np.uint8))


@lru_cache(maxsize=4)
def _decode_room(png: bytes) -> Depth:
    return decode_depth_png(png)


def draw(rendition: Rendition, background: bytes | None) -> list[tuple[str, bytes | Pixels]]:
    """Return a rendition's files by suffix. Raises RENDITION_CORRUPTED."""
    if rendition.encoding != ENCODING_PNG16:
        return [sense_file(rendition)]
    files: list[tuple[str, bytes | Pixels]] = [("depth.png", own_depth(rendition))]
    if background is None:
        return files
    box = (rendition.x, rendition.y, rendition.box_width, rendition.box_height)
    return [("png", colour_pixels(compose_on(_decode_room(background), *box, rendition.pixels))), *files]


def _read_leaves(opening: RecordOpening, state: RecordRow) -> list[bytes]:
    leaves = [read_bytes(RECORD_OPENINGS, leaf) for leaf in opening.commitment_leaves]
    if len(leaves) != len(opening.salts) or len(leaves) > CLIP_FRAMES_MAX_COUNT:
        raise BlockRobotError("BUNDLE_INVALID", "A record has other numbers of leaves and salts, or too many.")
    if leaves and (any(len(leaf) != HASH_SIZE_BYTES for leaf in leaves)):
        raise BlockRobotError("BUNDLE_INVALID", "A leaf does not have 32 bytes.")
    if leaves and commitment_root(leaves) != state.commitment_root:
        raise BlockRobotError(
            "BUNDLE_UNPROVEN", f"The frames of record {opening.record_id} are not those that the ledger commits to."
        )
    return leaves


def walk_frames(
    visit: int, record: int, opening: RecordOpening, state: RecordRow, source: FrameSource, seen: set[bytes]
) -> Generator[Piece, None, list[FrameDocument]]:
    """Yield a record's files in order; return documents. Raises BUNDLE_INVALID, BUNDLE_UNPROVEN, RENDITION_CORRUPTED."""
    documents = []
    for index, leaf in enumerate(_read_leaves(opening, state)):
        salt = read_bytes(RECORD_OPENINGS, opening.salts[index])
        if not salt:
            status = ERASED if index in state.erased_frames else ABSENT
            documents.append(FrameDocument(index, status, 0, 0, "", "", []))
            continue
        name = rendition_name(visit, record, index)
        if index in state.erased_frames:
            raise BlockRobotError("BUNDLE_UNPROVEN", f"{name} is erased on the ledger, and yet the bundle opens it.")
        content = source.committed(name, bytes.fromhex(opening.record_id), index)
        if commitment_leaf(salt, index, sha256(content)) != leaf:
            raise BlockRobotError("BUNDLE_UNPROVEN", f"{name} is not what the robot committed to.")
        rendition = decode_rendition(content)
        yield Piece(name, content, is_drawn=False)
        background = source.background(rendition.background_id) if rendition.encoding == ENCODING_PNG16 else None
        if background is not None and rendition.pixels and rendition.background_id not in seen:
            if sha256(background) != rendition.background_id:
                raise BlockRobotError("BUNDLE_UNPROVEN", f"The empty room of {name} is not the one it was taken in.")
            seen.add(rendition.background_id)
            yield Piece(background_name(rendition.background_id), background, is_drawn=False)
        status, files = _draw_all(rendition, background)
        shown = [(shown_name(visit, record, index, suffix), data) for suffix, data in files]
        for place, data in shown:
            yield Piece(place, data, is_drawn=True)
        about = (rendition.captured_at_ms, rendition.sequence, rendition.encoding)
        documents.append(FrameDocument(index, status, *about, name, [place for place, _ in shown]))
    return documents


def _draw_all(rendition: Rendition, background: bytes | None) -> tuple[str, list[tuple[str, bytes | Pixels]]]:
    if not rendition.pixels:
        return NOTICE, []
    try:
        return PICTURE, draw(rendition, background)
    except BlockRobotError:
        return UNDRAWABLE, []


def is_same_file(piece: Piece, stored: bytes) -> bool:
    """Return whether bytes are equal, or both are PNGs with equal pixels."""
    made = piece.made
    if not piece.is_drawn or not piece.name.endswith(".png") or not _has_only_pixels(stored):
        return stored == piece.content
    decode = decode_depth_png if piece.name.startswith("depth/") else decode_colour_png
    try:
        return bool(np.array_equal(decode(stored), decode(made) if isinstance(made, bytes) else made))
    except BlockRobotError:
        return False


def _has_only_pixels(png: bytes) -> bool:
    place, found = len(PNG_SIGNATURE), 0
    while place + 12 <= len(png):
        (length,) = struct.unpack_from(">I", png, place)
        if png[place + 4 : place + 8] not in _CHUNKS:
            return False
        place, found = place + 12 + length, found + 1
    return found > 2 and place == len(png)


def count_pictures(frames: Sequence[FrameDocument]) -> int:
    return sum(bool(frame.files) for frame in frames)
