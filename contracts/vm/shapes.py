"""Dicts of the same shape, encoded without a walk of Python over their items. Must never change what a dict costs.

A contract stores and emits dicts with the same names and types again and again. What follows from names and types
alone is worked out once for each such shape: the order of the encoded keys, the charge, which items have a length.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Any, NamedTuple

from consensus.primitives.encoding import encode_ordered, sort_keys

_KEYS_MAX_COUNT = 32
_KEYS_MAX_BYTES = 1024
_SHAPES_MAX_COUNT = 512
_SCALARS = frozenset((int, bool, type(None)))
_CONTAINERS = frozenset((list, tuple, dict))

Select = Callable[[dict[Any, Any]], tuple[Any, ...]]


class _Shape(NamedTuple):
    """What all dicts of one shape share. `size` counts the bytes of the keys and one for each item; `gas` the walk."""

    keys: tuple[Any, ...]
    items: Select
    texts: Select
    containers: Select | None
    size: int
    gas: int


_shapes: dict[tuple[Any, ...], _Shape] = {}


def _select(keys: list[Any]) -> Select:
    if not keys:
        return lambda _: ()
    if len(keys) == 1:
        only = keys[0]
        return lambda value: (value[only],)
    return itemgetter(*keys)


def _work_out(names: tuple[Any, ...], kinds: tuple[type, ...]) -> _Shape | None:
    texts = [name for name, kind in zip(names, kinds, strict=True) if kind is bytes or kind is str]
    containers = [name for name, kind in zip(names, kinds, strict=True) if kind in _CONTAINERS]
    scalars = sum(kind in _SCALARS for kind in kinds)
    size = len(names) + sum(1 if type(name) is int else len(name) for name in names)
    if len(texts) + len(containers) + scalars != len(names) or size > _KEYS_MAX_BYTES:
        return None
    keys = sort_keys(names)
    gas = 2 + 3 * len(names) + 2 * len(containers)
    return _Shape(keys, _select(list(keys)), _select(texts), _select(containers) if containers else None, size, gas)


def encode_by_shape(value: dict[Any, Any], size_max: int) -> tuple[bytes, int] | None:
    """Return a dict's canonical bytes and the gas of its walk; None if it holds more than scalars, texts and empty
    containers, has many keys, or comes near `size_max` bytes: such a one must be walked.
    """
    if len(value) > _KEYS_MAX_COUNT:
        return None
    names, kinds = tuple(value), tuple(map(type, value.values()))
    shape = _shapes.get((names, kinds))
    if shape is None:
        shape = _work_out(names, kinds)
        if shape is None:
            return None
        if len(_shapes) >= _SHAPES_MAX_COUNT:
            _shapes.clear()
        _shapes[names, kinds] = shape
    keys, items, texts, containers, size, gas = shape
    if (containers is not None and any(containers(value))) or size + sum(map(len, texts(value))) > size_max:
        return None
    data = encode_ordered(dict(zip(keys, items(value), strict=True)))
    return None if data is None else (data, gas)
