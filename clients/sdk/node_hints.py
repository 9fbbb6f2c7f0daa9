"""What the user says of where nodes are, and who tells them what was wrong with it: set by the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from consensus.errors import BlockRobotError


def _nothing(_chain_id: bytes) -> tuple[Sequence[str], Path | None]:
    return (), None


def _nobody(_refusal: BlockRobotError) -> None:
    return None


@dataclass(slots=True)
class NodeHints:
    """`read`: by a chain's id, the typed addresses and the file of nodes; `tell`: why an address is not used."""

    read: Callable[[bytes], tuple[Sequence[str], Path | None]] = _nothing
    tell: Callable[[BlockRobotError], None] = _nobody


HINTS = NodeHints()
