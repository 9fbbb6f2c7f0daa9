"""The worker's cache of block writes above the stored ledger, by state root; merged."""

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
    """Block results, oldest first, at most `LAYERS_MAX_COUNT`."""

    def __init__(self) -> None:
        self._layers: dict[bytes, _Layer] = {}
        self._merged: _Merged | None = None

    @property
    def count(self) -> int:
        return 0 if self._merged is None else self._merged.count

    def view(self, base: StateView, root: bytes) -> StateView | None:
        """Over `base`; None if unknown."""
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
        self._merged = None
        if root in self._layers:
            for older in list(self._layers):
                del self._layers[older]
                if older == root:
                    return
