"""Writing the trie in batches: what is written, what collapses, what damage is noticed."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.trie import EMPTY_ROOT, Proof, hash_page, verify_proof
from contracts.state import trie
from contracts.state.trie import EmptyPages, apply_batch, prove
from contracts.state.view import MemoryState


def content(count: int, label: str = "key") -> dict[bytes, bytes | None]:
    return {f"{label}-{number}".encode(): f"value {number}".encode() for number in range(count)}


def state_of(writes) -> MemoryState:
    state = MemoryState()
    state.apply(writes)
    return state


def test_what_is_written_or_deleted_in_vain_changes_nothing():
    update = apply_batch(EmptyPages(), EMPTY_ROOT, {})
    assert (update.root, update.pages) == (EMPTY_ROOT, {})
    state = state_of(content(50))
    update = apply_batch(state, state.state_root, {b"absent": None, b"absent too": None})
    assert (update.root, update.pages) == (state.state_root, {})
    assert apply_batch(EmptyPages(), EMPTY_ROOT, {b"absent": None}).root == EMPTY_ROOT
    state = state_of(content(300))
    update = apply_batch(state, state.state_root, content(300))
    assert (update.root, update.pages) == (state.state_root, {})


def test_a_single_key_is_a_root_page_with_one_leaf():
    state = state_of({b"only": b"one"})
    assert list(state.pages) == [b""]
    assert hash_page(state.pages[b""]) == state.state_root
    state.apply({b"only": None})
    assert (state.state_root, dict(state.pages)) == (EMPTY_ROOT, {})


def test_there_is_a_page_exactly_where_two_keys_share_a_path():
    keys = content(1000)
    paths = [sha256(key).hex().encode() for key in keys]
    expected = {b""}
    for depth in range(1, 12):
        prefixes = [path[:depth] for path in paths]
        expected |= {prefix for prefix in set(prefixes) if prefixes.count(prefix) > 1}
    assert set(state_of(keys).pages) == expected


def test_deletion_collapses_to_the_pages_that_were_never_more():
    small, large = content(40), content(900, "more")
    grown_and_cut = state_of(small)
    grown_and_cut.apply(large)
    grown_and_cut.apply(dict.fromkeys(large))
    assert dict(grown_and_cut.pages) == dict(state_of(small).pages)
    assert grown_and_cut.state_root == state_of(small).state_root


def test_a_batch_touches_only_the_pages_above_its_keys():
    state = state_of(content(2000))
    update = apply_batch(state, state.state_root, {b"key-7": b"changed"})
    path = sha256(b"key-7").hex().encode()
    assert set(update.pages) == {path[:depth] for depth in range(len(update.pages))}


def test_a_changed_value_changes_the_root_and_back_again():
    state = state_of(content(100))
    before = state.state_root
    state.apply({b"key-1": b"other"})
    assert state.state_root != before
    state.apply({b"key-1": b"value 1"})
    assert state.state_root == before


def test_an_empty_value_is_a_value_and_the_empty_trie_proves_absence():
    state = state_of({b"flag": b"", b"other": b"x"})
    verify_proof(state.state_root, b"flag", b"", state.prove(b"flag"))
    assert state.state_root != state_of({b"other": b"x"}).state_root
    proof = prove(EmptyPages(), EMPTY_ROOT, b"key")
    assert isinstance(proof, Proof)
    verify_proof(EMPTY_ROOT, b"key", None, proof)


def test_a_missing_page_is_reported_as_damage():
    state = state_of(content(300))
    with pytest.raises(BlockRobotError, match=r"^STORAGE_DAMAGED:"):
        apply_batch(EmptyPages(), state.state_root, {b"key-1": b"x"})
    with pytest.raises(BlockRobotError, match=r"^STORAGE_DAMAGED:"):
        prove(EmptyPages(), state.state_root, b"key-1")


def test_a_page_that_decayed_on_disk_never_reaches_a_root():
    state = state_of(content(300))
    path = sha256(b"key-1").hex().encode()[:1]
    decayed = bytearray(state.pages[path])
    decayed[-1] ^= 1

    class Decayed:
        def page(self, wanted):
            return bytes(decayed) if wanted == path else state.page(wanted)

    with pytest.raises(BlockRobotError) as caught:
        apply_batch(Decayed(), state.state_root, {b"key-1": b"x"})
    assert caught.value.code == "STORAGE_DAMAGED"
    assert path.decode() in caught.value.detail


def test_a_page_that_changed_on_its_way_is_found_out_even_where_its_maker_knew_it() -> None:
    state = MemoryState()
    state.apply({b"key %d" % number: b"value" for number in range(40)})
    path, page = next((path, page) for path, page in state.pages.items() if path)
    state._pages[path] = bytes([page[0] ^ 1]) + page[1:]
    touching = {b"key %d" % number: b"other" for number in range(40)}
    with pytest.raises(BlockRobotError, match="is not the one that is referred to"):
        state.apply(touching)


def test_the_memory_of_pages_made_here_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trie, "_OWN_PAGES_MAX_COUNT", 10)
    MemoryState().apply({b"key %d" % number: b"value" for number in range(400)})
    assert len(trie._own_pages) <= 10
