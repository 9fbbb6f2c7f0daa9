"""Fast encoding of dicts that share keys and types; gas is unchanged."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Any, NamedTuple

from consensus.primitives.encoding import encoder_of_dicts, sort_keys
from contracts.vm.model.meter import Runtime

WALKED_LIST_GAS = 2
WALKED_DICT_GAS = 4
WALKED_ENTRY_GAS = 4

_KEYS_MAX_COUNT = 32
_KEYS_MAX_BYTES = 1024
_SHAPES_MAX_COUNT = 512
_SCALARS = frozenset((int, bool, type(None)))
_CONTAINERS = frozenset((list, tuple, dict))

Select = Callable[[Any], tuple[Any, ...]]


class _Shape(NamedTuple):
    """Shared facts of one shape: `size` counts key bytes plus one per item, `gas` the walk.

    `items` selects values in encoded key order; `texts` and `containers` select from these.
    """

    kinds: tuple[type, ...]
    items: Select
    texts: Select
    containers: Select | None
    size: int
    gas: int
    encode: Callable[[tuple[Any, ...]], bytes | None]


_shapes: dict[tuple[Any, ...], _Shape] = {}
_latest: dict[tuple[Any, ...], _Shape] = {}
"""The shapes by names and types, and by names alone the one that was met last."""


def _select(keys: list[Any]) -> Select:
    if not keys:
        return lambda _: ()
    if len(keys) == 1:
        only = keys[0]
        return lambda value: (value[only],)
    return itemgetter(*keys)


def _work_out(names: tuple[Any, ...], value: dict[Any, Any]) -> _Shape | None:
    size = len(names) + sum(1 if type(name) is int else len(name) for name in names)
    if size > _KEYS_MAX_BYTES:
        return None
    keys = sort_keys(names)
    kinds = tuple([type(value[key]) for key in keys])
    texts = [place for place, kind in enumerate(kinds) if kind is bytes or kind is str]
    containers = [place for place, kind in enumerate(kinds) if kind in _CONTAINERS]
    scalars = sum(kind in _SCALARS for kind in kinds)
    if len(texts) + len(containers) + scalars != len(names):
        return None
    gas = WALKED_DICT_GAS + WALKED_ENTRY_GAS * len(names)
    gas += sum(WALKED_DICT_GAS if kinds[place] is dict else WALKED_LIST_GAS for place in containers)
    inner = _select(containers) if containers else None
    return _Shape(kinds, _select(list(keys)), _select(texts), inner, size, gas, encoder_of_dicts(keys))


def _find(names: tuple[Any, ...], value: dict[Any, Any]) -> _Shape | None:
    place = names, tuple(map(type, value.values()))
    shape = _shapes.get(place) or _work_out(names, value)
    if shape is not None:
        if len(_shapes) >= _SHAPES_MAX_COUNT:
            _shapes.clear()
            _latest.clear()
        _shapes[place] = _latest[names] = shape
    return shape


def encode_by_shape(runtime: Runtime, value: dict[Any, Any], size_max: int) -> bytes | None:
    """Return canonical bytes and charge the walk; None without charge if it must be walked.

    That is: non-empty containers inside, many keys, or a size near `size_max`.
    """
    if len(value) > _KEYS_MAX_COUNT:
        return None
    names = tuple(value)
    shape = _latest.get(names) or _find(names, value)
    if shape is None:
        return None
    kinds, select, texts, containers, size, gas, encode = shape
    items = select(value)
    if tuple(map(type, items)) != kinds:
        shape = _find(names, value)
        if shape is None:
            return None
        _, _, texts, containers, size, gas, encode = shape
    if (containers is not None and any(containers(items))) or size + sum(map(len, texts(items))) > size_max:
        return None
    data = encode(items)
    if data is None or len(data) > size_max:
        return None
    runtime.gas -= gas
    if runtime.gas < 0:
        runtime.exhausted()
    return data
