"""Scans over overlays, a block's calls and what a call itself wrote give what a plain dict would, in every order."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from contracts.execution.call_host import CallHost
from contracts.state.key_cache import KeyCache
from contracts.state.view import MemoryState, Overlay

KEYS = st.lists(st.sampled_from(b"a\x00\xff"), min_size=1, max_size=4).map(bytes)
WRITES = st.dictionaries(KEYS, st.none() | st.binary(min_size=1, max_size=1), max_size=12)
PREFIXES = st.lists(st.sampled_from(b"a\x00\xff"), max_size=3).map(bytes)
STEPS = st.lists(
    st.tuples(st.just("write"), WRITES)
    | st.tuples(st.just("scan"), PREFIXES, st.integers(1, 6))
    | st.tuples(st.sampled_from(["keep", "fail", "block"])),
    max_size=25,
)


def expected(model: dict[bytes, bytes | None], prefix: bytes, limit: int) -> list[tuple[bytes, bytes | None]]:
    there = sorted((key, value) for key, value in model.items() if value is not None and key.startswith(prefix))
    return there[:limit]


@given(WRITES, st.lists(WRITES, max_size=3), STEPS)
def test_scans_give_what_is_there(stored, blocks, steps):
    view = MemoryState()
    view.apply(stored)
    model = dict(stored)
    for writes in blocks:
        view = Overlay.apply(view, writes)
        model |= writes
    host = CallHost(view)
    kept, seen = dict(model), dict(model)
    for step in steps:
        if step[0] == "write":
            for key, value in step[1].items():
                host.delete(key) if value is None else host.put(key, value)
            seen |= step[1]
        elif step[0] == "scan":
            assert host.scan(step[1], step[2]) == expected(seen, step[1], step[2])
        elif step[0] == "keep":
            host.keep()
            kept = dict(seen)
        elif step[0] == "fail":
            host.begin()
            seen = dict(kept)
        else:
            view = Overlay.apply(view, host.writes)
            host = CallHost(view)
            seen, model = dict(kept), dict(kept)
            assert list(view.scan(b"", 1_000)) == expected(kept, b"", 1_000)


@given(st.sets(KEYS, max_size=30), st.lists(st.tuples(PREFIXES, PREFIXES, st.integers(1, 6)), max_size=20))
def test_a_key_cache_reads_no_key_twice(keys, questions):
    read: list[bytes] = []

    def read_range(start: bytes, end: bytes):
        for key in sorted(keys):
            if start <= key < end:
                read.append(key)
                yield key

    cache = KeyCache(read_range)
    for start, end, count in questions:
        assert cache.first(start, end, count) == [key for key in sorted(keys) if start <= key < end][:count]
    assert len(read) == len(set(read))
