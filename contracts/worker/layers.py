"""What blocks above the stored ledger wrote, by state root, kept in the worker. Must never answer for a root it has not.

A state root names a whole state, so it names a block's result too. The layers between the ledger that the worker reads
and the state that is asked for are merged into one, so that a read costs the same however many there are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from contracts.state.view import Overlay, StateView

LAYERS_MAX_COUNT = 384

_Rows = Mapping[bytes, bytes | None]


@dataclass(frozen=True, slots=True)
class _Layer:
    parent_root: bytes
    writes: _Rows
    pages: _Rows


@dataclass(slots=True)
class _Merged:
    """All layers from `base_root` up to `top_root`."""

    base_root: bytes
    top_root: bytes
    count: int = 0
    writes: dict[bytes, bytes | None] = field(default_factory=dict)
    pages: dict[bytes, bytes | None] = field(default_factory=dict)

    def add(self, root: bytes, layer: _Layer) -> None:
        self.writes.update(layer.writes)
        self.pages.update(layer.pages)
        self.top_root = root
        self.count += 1


class Layers:
    """The results of blocks, oldest first; at most `LAYERS_MAX_COUNT`."""

    def __init__(self) -> None:
        self._layers: dict[bytes, _Layer] = {}
        self._merged: _Merged | None = None

    @property
    def count(self) -> int:
        """How many layers the state that was asked for last stands above the ledger."""
        return 0 if self._merged is None else self._merged.count

    def view(self, base: StateView, root: bytes) -> StateView | None:
        """Return the state with this root over the ledger as `base` has it, or None if it cannot be told from here."""
        if base.state_root == root:
            self._merged = None
            return base
        merged = self._merged
        if merged is None or merged.base_root != base.state_root or merged.top_root != root:
            self._merged = merged = self._merge(base.state_root, root)
        return None if merged is None else Overlay(base, merged.writes, merged.pages, root)

    def _merge(self, base_root: bytes, root: bytes) -> _Merged | None:
        path: list[tuple[bytes, _Layer]] = []
        wanted = root
        while wanted != base_root:
            layer = self._layers.get(wanted)
            if layer is None or len(path) >= LAYERS_MAX_COUNT:
                return None
            path.append((wanted, layer))
            wanted = layer.parent_root
        merged = _Merged(base_root, base_root)
        for above, layer in reversed(path):
            merged.add(above, layer)
        return merged

    def add(self, base_root: bytes, parent_root: bytes, root: bytes, writes: _Rows, pages: _Rows) -> None:
        """Keep what a block on `parent_root` wrote; `base_root` is the ledger's as it is read now."""
        if root == parent_root:
            return
        layer = _Layer(parent_root, writes, pages)
        self._layers.pop(root, None)
        self._layers[root] = layer
        while len(self._layers) > LAYERS_MAX_COUNT:
            del self._layers[next(iter(self._layers))]
        merged = self._merged
        if merged is None and parent_root == base_root:
            merged = self._merged = _Merged(base_root, base_root)
        if merged is not None and merged.base_root == base_root and merged.top_root == parent_root:
            merged.add(root, layer)

    def stand_on(self, root: bytes) -> None:
        """The ledger is read anew, with this root: forget what was kept no later than that."""
        self._merged = None
        if root in self._layers:
            for older in list(self._layers):
                del self._layers[older]
                if older == root:
                    return
