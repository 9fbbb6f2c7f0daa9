"""Keeps what was there before out of the garbage collector's way.

Collection alone leaves some fourteen thousand tests in a process. Walked at each full collection, they slow every test
down, and falsify what programs are measured to take.
"""

from __future__ import annotations

import gc

import pytest


def freeze() -> None:
    """Let no later collection look at what is here now.

    What was frozen before stays so: walking it anew for every module took longer than most modules' tests.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def frozen_heap() -> None:
    """Also what the tests before left."""
    freeze()
