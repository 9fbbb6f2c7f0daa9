"""The trie against a dict: for any history the root, the pages and every proof depend on the content only."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.trie import EMPTY_ROOT, Proof, verify_proof
from contracts.state.trie import compute_root
from contracts.state.view import MemoryState, Overlay

# Keys whose paths start alike, so that small histories still build and collapse pages four and five levels deep.
CLOSE_KEYS = [key for key in (b"k%d" % number for number in range(30_000)) if sha256(key)[0] == 0xA7][:96]
keys = st.sampled_from(CLOSE_KEYS) | st.binary(min_size=1, max_size=4)
batches = st.lists(st.dictionaries(keys, st.none() | st.binary(max_size=6), max_size=24), max_size=8)


def replay(history) -> tuple[MemoryState, dict[bytes, bytes]]:
    state, oracle = MemoryState(), {}
    for batch in history:
        state.apply(batch)
        for key, value in batch.items():
            oracle.pop(key, None)
            if value is not None:
                oracle[key] = value
    return state, oracle


@given(batches)
def test_the_root_and_the_pages_follow_from_the_content(history):
    state, oracle = replay(history)
    fresh = MemoryState()
    fresh.apply(oracle)
    assert dict(state.scan(b"", 10_000)) == oracle
    assert state.state_root == fresh.state_root == compute_root(oracle.items())
    assert dict(state.pages) == dict(fresh.pages)
    assert (state.state_root == EMPTY_ROOT) == (not oracle)


@given(st.dictionaries(keys, st.binary(max_size=6), max_size=40), st.randoms(use_true_random=False), batches)
def test_any_order_of_writes_with_the_same_end_has_the_same_root(final, random, detour):
    steps = [{key: value} for key, value in final.items()]
    random.shuffle(steps)
    direct, _ = replay(steps)
    wandering, _ = replay(detour)
    leftovers = {key: None for key, _ in wandering.scan(b"", 10_000) if key not in final}
    last = [leftovers, *steps]
    random.shuffle(last)
    for step in last:
        wandering.apply(step)
    assert wandering.state_root == direct.state_root


@given(batches, keys)
def test_any_key_can_be_proved_and_nothing_else_about_it(history, key):
    state, oracle = replay(history)
    proof = state.prove(key)
    truth = oracle.get(key)
    verify_proof(state.state_root, key, truth, proof)
    for lie in {None, b"a lie", b""} - {truth}:
        with pytest.raises(BlockRobotError, match="PROOF_INVALID"):
            verify_proof(state.state_root, key, lie, proof)


@given(batches, keys, st.data())
def test_a_tampered_proof_is_refused(history, key, data):
    state, oracle = replay(history)
    pages = list(state.prove(key).pages)
    number = data.draw(st.integers(0, len(pages) - 1))
    how = data.draw(st.sampled_from(["flip", "cut", "lengthen", "drop", "repeat"]))
    page = pages[number]
    if how == "flip":
        position = data.draw(st.integers(0, len(page) - 1))
        bit = 1 << data.draw(st.integers(0, 7))
        pages[number] = page[:position] + bytes([page[position] ^ bit]) + page[position + 1 :]
    elif how == "cut":
        pages[number] = page[: data.draw(st.integers(0, len(page) - 1))]
    elif how == "lengthen":
        pages[number] = page + data.draw(st.binary(min_size=1, max_size=64))
    elif how == "drop":
        del pages[number]
    else:
        pages.insert(number, page)
    with pytest.raises(BlockRobotError, match="PROOF_INVALID"):
        verify_proof(state.state_root, key, oracle.get(key), Proof(tuple(pages)))


@given(batches, batches, st.binary(max_size=2), st.integers(0, 20))
def test_overlays_read_as_if_their_blocks_were_final(finalized, unfinalized, prefix, limit):
    base, oracle = replay(finalized)
    flat, _ = replay([*finalized, *unfinalized])
    view = base
    for batch in unfinalized:
        view = Overlay.apply(view, batch)
    assert list(view.scan(prefix, limit)) == list(flat.scan(prefix, limit))
    assert view.state_root == flat.state_root
    assert dict(base.scan(b"", 10_000)) == oracle
