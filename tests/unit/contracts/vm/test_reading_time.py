"""Reading a source takes time by its length, whatever it says: what is said again and again costs no more each time.

Every short text of the signs that a source is made of is repeated behind every opening, so that no list has to know it.
"""

from __future__ import annotations

import contextlib
import itertools
import time

import pytest

from contracts.vm import ContractSourceError
from contracts.vm.frontend.checker import check_source

SIGNS = ("\\", "\n", "'", '"', "{", "(", "#", "a", "0", "_", ".", " ", "=", "\xe9")
OPENINGS = ("", "x = '", "x = '''", 'x = """', "x = f'{", "# ", "x = 0x", "x = (", "def f():\n    ")
ENDINGS = ("", '"', "'", "\n")


def seconds(source: str) -> float:
    """Return the CPU time that a check takes, whatever comes of it."""
    started = time.thread_time()
    with contextlib.suppress(ContractSourceError):
        check_source(source, "it")
    return time.thread_time() - started


def repeated(times: int, longest: int) -> list[str]:
    """Return each opening, and behind it so many times each text of at most so many signs."""
    texts = ["".join(text) for count in range(1, longest + 1) for text in itertools.product(SIGNS, repeat=count)]
    return [opening + text * times for opening in OPENINGS for text in texts]


def test_no_long_or_repeated_text_takes_long_to_read():
    for source in repeated(24, 2):
        for ending in ENDINGS:
            assert seconds(source + ending) < 0.25, source
    for source in repeated(30_000, 1):
        assert seconds(source[:60_000]) < 2, source[:40]


@pytest.mark.long
def test_no_text_of_three_signs_doubles_the_time():
    for source in repeated(24, 3):
        assert seconds(source) < 0.25, source
