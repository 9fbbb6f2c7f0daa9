"""Trees of the whole code base are made, looked at and let go without the garbage collector, which they would keep busy."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from tests.architecture import trees


@pytest.fixture(scope="module", autouse=True)
def trees_are_let_go() -> Iterator[None]:
    gc.disable()
    yield
    trees.forget()
    gc.enable()
