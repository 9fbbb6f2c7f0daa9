"""The inputs that a fuzzer found and kept, played through the parsers again. Searching for more: `python -m tests.fuzz`."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from tests.fuzz import corpus
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS, open_target

REPLAY_MAX_S = 2.0
KEPT_MAX_BYTES = 500_000


@pytest.fixture(params=sorted(TARGETS))
def target(request: pytest.FixtureRequest) -> Iterator[Target]:
    opened = open_target(request.param)
    yield opened
    opened.close()


def test_what_was_found_once_is_read_or_refused_in_time(target: Target) -> None:
    inputs = [*target.seeds, *corpus.load(target.name).values()]
    for data in inputs:
        began_s = time.process_time()
        target.run(data)
        assert time.process_time() - began_s < REPLAY_MAX_S


def test_the_corpus_is_small_and_of_the_targets_that_are_there() -> None:
    archives = {path.name.removesuffix(".tar.xz"): path.stat().st_size for path in corpus.KEPT.iterdir()}
    assert archives.keys() == TARGETS.keys()
    assert sum(archives.values()) <= KEPT_MAX_BYTES
