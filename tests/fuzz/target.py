"""What is fuzzed: bytes of a stranger's, given to a parser. Any exception but an error of the catalogue is a finding."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from random import Random

from consensus.errors import BlockRobotError

FlipBytes = Callable[[bytes, Random], bytes]


@contextmanager
def refusing(*codes: str) -> Iterator[None]:
    """Take errors of the catalogue whose code begins so for an answer; all others, and whatever else is raised, pass."""
    try:
        yield
    except BlockRobotError as error:
        if not error.code.startswith(codes):
            raise


@dataclass(frozen=True)
class Target:
    """One parser.

    `run` returns for what is read and for what is refused by an error of the catalogue. `mutate` changes an input so
    that it gets past checksums and canonical forms, with the help of a function that changes plain bytes.
    """

    name: str
    seeds: Sequence[bytes]
    run: Callable[[bytes], None]
    mutate: Callable[[bytes, Random, FlipBytes], bytes] | None = None
    input_max_bytes: int = 64 * 1024
    close: Callable[[], None] = lambda: None
