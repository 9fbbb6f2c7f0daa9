"""Overlays of unfinalized blocks: reads see the branch, in order, and the finalized state stays as it is."""

from __future__ import annotations

import pytest

from consensus.primitives.trie import verify_proof
from contracts.state.view import MemoryState, Overlay


@pytest.fixture
def base():
    state = MemoryState()
    state.apply({b"a/1": b"1", b"a/3": b"3", b"a/5": b"5", b"b/1": b"x"})
    return state


def pairs(view, prefix: bytes, limit: int = 100):
    return list(view.scan(prefix, limit))


def test_scans_are_in_key_order_and_an_overlay_reads_its_own_writes_first(base):
    assert pairs(base, b"a/") == [(b"a/1", b"1"), (b"a/3", b"3"), (b"a/5", b"5")]
    assert pairs(base, b"a/", 2) == [(b"a/1", b"1"), (b"a/3", b"3")]
    assert pairs(base, b"a/", 0) == []
    assert [key for key, _ in pairs(base, b"")] == [b"a/1", b"a/3", b"a/5", b"b/1"]
    overlay = Overlay.apply(base, {b"a/1": b"new", b"a/3": None})
    assert overlay.get(b"a/1") == b"new"
    assert overlay.get(b"a/3") is None
    assert overlay.get(b"a/5") == b"5"
    assert base.get(b"a/1") == b"1"


def test_a_scan_merges_both_sides_in_order_and_deletions_do_not_use_up_its_limit(base):
    overlay = Overlay.apply(base, {b"a/0": b"0", b"a/3": None, b"a/4": b"4", b"a/5": b"V", b"a/9": b"9", b"c": b"c"})
    assert pairs(overlay, b"a/") == [(b"a/0", b"0"), (b"a/1", b"1"), (b"a/4", b"4"), (b"a/5", b"V"), (b"a/9", b"9")]
    assert pairs(overlay, b"b/") == [(b"b/1", b"x")]
    overlay = Overlay.apply(base, {b"a/1": None, b"a/3": None})
    assert pairs(overlay, b"a/", 1) == [(b"a/5", b"5")]
    emptied = Overlay.apply(overlay, {b"a/5": None})
    assert pairs(emptied, b"a/", 1) == []
    assert pairs(overlay, b"a/", 0) == []


def test_overlays_chain_like_the_blocks_that_made_them(base):
    view = base
    for height in range(64):
        view = Overlay.apply(view, {b"count": b"%d" % height, b"block/%03d" % height: b"there"})
    assert view.get(b"count") == b"63"
    assert view.get(b"a/1") == b"1"
    assert [key for key, _ in pairs(view, b"block/")] == [b"block/%03d" % height for height in range(64)]


def test_branches_and_copies_of_one_parent_do_not_see_each_other(base):
    left = Overlay.apply(base, {b"side": b"left"})
    right = Overlay.apply(base, {b"side": b"right"})
    assert (left.get(b"side"), right.get(b"side"), base.get(b"side")) == (b"left", b"right", None)
    assert left.state_root != right.state_root
    other = base.copy()
    other.apply({b"a/1": None})
    assert base.get(b"a/1") == b"1"
    assert base.state_root != other.state_root


def test_an_overlay_has_the_root_of_what_it_shows_and_refuses_a_base_that_says_something_else(base):
    overlay = Overlay.apply(Overlay.apply(base, {b"a/1": None}), {b"new": b"n"})
    fresh = MemoryState()
    fresh.apply(dict(overlay.scan(b"", 100)))
    assert overlay.state_root == fresh.state_root
    verify_proof(overlay.state_root, b"new", b"n", overlay.prove(b"new"))
    verify_proof(overlay.state_root, b"a/1", None, overlay.prove(b"a/1"))
    child = Overlay.apply(base, {b"c": b"c"})
    with pytest.raises(ValueError, match="rebased"):
        child.rebase(MemoryState())


def test_finalizing_the_parent_and_rebasing_changes_nothing_that_is_read(base):
    parent = Overlay.apply(base, {b"a/1": None, b"p": b"p"})
    child = Overlay.apply(parent, {b"c": b"c"})
    before = (pairs(child, b""), child.state_root)
    finalized = base.copy()
    finalized.absorb(parent.writes, parent.page_writes, parent.state_root)
    child.rebase(finalized)
    assert (pairs(child, b""), child.state_root) == before
    assert Overlay.apply(child, {b"d": b"d"}).get(b"p") == b"p"
