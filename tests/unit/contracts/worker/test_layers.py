"""What a worker keeps above the ledger: the same rows as overlays on overlays, or the admission that it cannot tell."""

from __future__ import annotations

from contracts.state.view import MemoryState, Overlay, StateView
from contracts.worker.layers import LAYERS_MAX_COUNT, Layers


def block(layers: Layers, base: StateView, parent: StateView, **writes: str | None) -> Overlay:
    """Execute a block that writes these, and keep what it wrote."""
    made = Overlay.apply(
        parent, {key.encode(): None if value is None else value.encode() for key, value in writes.items()}
    )
    layers.add(base.state_root, parent.state_root, made.state_root, made.writes, made.page_writes)
    return made


def rows(view: StateView | None) -> list[tuple[bytes, bytes]]:
    assert view is not None
    return list(view.scan(b"", 100))


def ledger(**content: str) -> MemoryState:
    state = MemoryState()
    state.apply({key.encode(): value.encode() for key, value in content.items()})
    return state


def test_a_branch_reads_as_its_overlays_do() -> None:
    base, layers = ledger(a="1", b="2"), Layers()
    first = block(layers, base, base, a="3", c="4")
    second = block(layers, base, first, b=None, c="5")
    view = layers.view(base, second.state_root)
    assert rows(view) == rows(second) == [(b"a", b"3"), (b"c", b"5")]
    assert layers.count == 2
    assert rows(layers.view(base, first.state_root)) == rows(first)
    assert layers.count == 1
    assert layers.view(base, base.state_root) is base
    assert layers.count == 0


def test_a_fork_does_not_show_in_the_other_branch_and_an_empty_block_is_no_layer() -> None:
    base, layers = ledger(a="1"), Layers()
    left, right = block(layers, base, base, a="left"), block(layers, base, base, b="right")
    left_child = block(layers, base, left, c="on left")
    right_child = block(layers, base, right, c="on right")
    for made in (left_child, right_child, left, right):
        assert rows(layers.view(base, made.state_root)) == rows(made)
    empty = block(layers, base, base)
    assert layers.view(base, empty.state_root) is base
    assert block(layers, base, empty, b="2").get(b"b") == b"2"


def test_pages_give_the_root_that_a_next_block_begins_with() -> None:
    base, layers = ledger(a="1", b="2", c="3"), Layers()
    first = block(layers, base, base, d="4", a=None)
    view = layers.view(base, first.state_root)
    assert view is not None
    assert Overlay.apply(view, {b"e": b"5"}).state_root == Overlay.apply(first, {b"e": b"5"}).state_root


def test_the_ledger_moves_up_under_the_branch() -> None:
    base, layers = ledger(a="1"), Layers()
    first = block(layers, base, base, a="2")
    second = block(layers, base, first, b="3")
    stored = base.copy()
    stored.absorb(first.writes, first.page_writes, first.state_root)
    layers.stand_on(stored.state_root)
    assert rows(layers.view(stored, second.state_root)) == rows(second)
    assert layers.count == 1
    assert layers.view(base, second.state_root) is None


def test_what_is_not_known_is_not_answered() -> None:
    base, layers = ledger(a="1"), Layers()
    assert layers.view(base, bytes(32)) is None
    unseen = Overlay.apply(base, {b"b": b"2"})
    child = block(layers, base, unseen, c="3")
    assert layers.view(base, child.state_root) is None
    stored = base.copy()
    stored.absorb(unseen.writes, unseen.page_writes, unseen.state_root)
    assert rows(layers.view(stored, child.state_root)) == rows(child)


def test_a_state_that_comes_back_makes_no_circle() -> None:
    base, layers = ledger(a="1"), Layers()
    there = block(layers, base, base, a="2")
    back = block(layers, base, there, a="1")
    assert back.state_root == base.state_root
    assert layers.view(base, back.state_root) is base
    other = ledger(z="9")
    assert layers.view(other, there.state_root) is None


def test_layers_are_bounded_and_the_oldest_go_first() -> None:
    base, layers = ledger(a="1"), Layers()
    made: list[Overlay] = []
    parent: StateView = base
    for number in range(LAYERS_MAX_COUNT + 1):
        made.append(block(layers, base, parent, n=str(number)))
        parent = ledger_of(made[-1])
    assert layers.view(base, made[-2].state_root) is None
    stored = ledger_of(made[0])
    assert rows(layers.view(stored, made[-1].state_root)) == [(b"a", b"1"), (b"n", str(LAYERS_MAX_COUNT).encode())]


def ledger_of(view: StateView) -> MemoryState:
    """Return the same state without what it was made of."""
    state = MemoryState()
    state.apply(dict(view.scan(b"", 1000)))
    return state
