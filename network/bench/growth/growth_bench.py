"""Measures how the cost of each operation grows with what is merely kept, over sizes that are filled once."""

from __future__ import annotations

import asyncio
import shutil
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path

from clients.wallet.store.member_keys import derive_keys
from network.bench.conditions import Result, measure_conditions
from network.bench.growth.growth_figures import GrowthFigures, Kind, SizeFigures, judge
from network.bench.growth.growth_ledgers import fill_ledger, open_chain
from network.bench.growth.growth_on_clients import WORDS, measure_person, measure_registry
from network.bench.growth.growth_on_custody import fill_custody, measure_custody
from network.bench.growth.growth_on_ledger import Measured, measure_chain, measure_members, measure_state
from network.bench.growth.growth_rows import member_rows, person_rows, record_key, record_rows
from node.custody import erase_keys
from node.custody.stores import sqlite_schema
from node.storage import lmdb_layout

FILL_VERSION = 1
"""Of what the cache holds: a change of the filling needs another."""
_LITTLE_COUNT = 100
"""Of members and blocks where others grow."""

KINDS: Mapping[str, Kind] = {
    "execution of a block": "operation",
    "commit of a block": "operation",
    "admission of a call": "operation",
    "state proof": "operation",
    "explorer search": "operation",
    "node start: ledger": "operation",
    "snapshot": "scan",
    "custodian: an empty block": "operation",
    "custodian: upload of a clip": "operation",
    "custodian: erasure of a clip": "operation",
    "custodian: expiry sweep": "operation",
    "custodian: catching up with 16 clips": "operation",
    "custodian: scrub of a clip": "operation",
    "custodian: download of a clip": "operation",
    "custodian start: keys reconciled": "scan",
    "custody status: counts": "scan",
    "scrub of all clips": "scan",
    "registry synchronisation: nothing new": "operation",
    "registry synchronisation: a roster of 100": "operation",
    "registry synchronisation: from nothing": "listing",
    "wallet records: one visit of them": "operation",
    "wallet records": "listing",
    "wallet audit": "listing",
}
"""Every operation that is measured."""

OnProgress = Callable[[str], None]


def _decades(first: int, last: int) -> tuple[int, ...]:
    return tuple(10**power for power in range(first, last + 1))


@dataclass(frozen=True, slots=True)
class Axis:
    """What grows: the sizes, the first of which are the default ones, how one is filled, and what is measured there."""

    what: str
    sizes: tuple[int, ...]
    default_count: int
    fill: Callable[[Path, int, OnProgress], Awaitable[None]]
    measure: Sequence[Callable[[Path, int], Measured]]

    def chosen(self, *, is_full: bool) -> tuple[int, ...]:
        return self.sizes if is_full else self.sizes[: self.default_count]


async def _fill_state(folder: Path, size: int, on_progress: OnProgress) -> None:
    rows = chain(member_rows(_LITTLE_COUNT), record_rows(size))
    await fill_ledger(folder, rows, _LITTLE_COUNT, on_progress)


async def _fill_chain(folder: Path, size: int, on_progress: OnProgress) -> None:
    rows = chain(member_rows(_LITTLE_COUNT), record_rows(_LITTLE_COUNT))
    await fill_ledger(folder, rows, size, on_progress)


async def _fill_members(folder: Path, size: int, on_progress: OnProgress) -> None:
    await fill_ledger(folder, member_rows(size), _LITTLE_COUNT, on_progress)


async def _fill_visits(folder: Path, size: int, on_progress: OnProgress) -> None:
    rows = person_rows(derive_keys(WORDS), size, open_chain().genesis.chain_id)
    await fill_ledger(folder, rows, _LITTLE_COUNT, on_progress)


async def _fill_clips(folder: Path, size: int, on_progress: OnProgress) -> None:
    await asyncio.to_thread(fill_custody, folder, size, on_progress)


AXES: Mapping[str, Axis] = {
    "clips": Axis("clips held", _decades(3, 6), 2, _fill_clips, (measure_custody,)),
    "state": Axis("entries of the state", _decades(4, 7), 2, _fill_state, (partial(measure_state, key=record_key),)),
    "chain": Axis("blocks of the chain", _decades(4, 6), 2, _fill_chain, (measure_chain,)),
    "members": Axis("members", _decades(2, 5), 3, _fill_members, (measure_registry, measure_members)),
    "visits": Axis("visits of one person", _decades(1, 4), 3, _fill_visits, (measure_person,)),
}


@dataclass(frozen=True, slots=True)
class GrowthOptions:
    """Where filled sizes are kept, and which are measured."""

    cache: Path
    axes: Mapping[str, tuple[int, ...]]


def choose_sizes(names: Sequence[str], *, is_full: bool) -> dict[str, tuple[int, ...]]:
    """Of these axes, or of all if none is named."""
    return {name: axis.chosen(is_full=is_full) for name, axis in AXES.items() if not names or name in names}


async def fill_once(cache: Path, name: str, size: int, on_progress: OnProgress) -> tuple[Path, float]:
    """Return the folder with this size, filled if it was not, and in how many seconds."""
    ledger = lmdb_layout.FORMAT_NAME.decode().rpartition("/")[2]
    formats = f"{ledger}-{sqlite_schema.FORMAT_VERSION}-{erase_keys.FORMAT_VERSION}"
    folder = cache / f"{name}-{size}-{FILL_VERSION}-{formats}"
    if folder.is_dir():
        return folder, 0.0
    part = folder.with_name(f"{folder.name}.part")
    await asyncio.to_thread(shutil.rmtree, part, ignore_errors=True)
    part.mkdir(parents=True, mode=0o700)
    started_s = time.perf_counter()
    await AXES[name].fill(part, size, on_progress)
    part.rename(folder)
    return folder, round(time.perf_counter() - started_s, 1)


@asynccontextmanager
async def _copied(folder: Path) -> AsyncIterator[Path]:
    """What is measured leaves its marks: in what is kept for the next time they would add up."""
    copy = folder.with_name(f"{folder.name}.measured")
    try:
        await asyncio.to_thread(shutil.rmtree, copy, ignore_errors=True)
        await asyncio.to_thread(shutil.copytree, folder, copy)
        yield copy
    finally:
        await asyncio.to_thread(shutil.rmtree, copy, ignore_errors=True)


async def run_growth_benchmark(
    options: GrowthOptions, on_progress: OnProgress = lambda _text: None
) -> Result[GrowthFigures]:
    """`ok` is False where a cost grows faster than it may."""
    conditions = measure_conditions(nodes=0, seed=None)
    found: dict[tuple[str, str], list[SizeFigures]] = {}
    filled_s: dict[str, float] = {}
    for name, sizes in options.axes.items():
        for size in sizes:
            on_progress(f"{AXES[name].what}: {size}")
            folder, filled_s[f"{name} {size}"] = await fill_once(options.cache, name, size, on_progress)
            async with _copied(folder) as copy:
                for measure in AXES[name].measure:
                    async for operation, figures in measure(copy, size):
                        on_progress(f"{AXES[name].what}: {size}, {operation}")
                        found.setdefault((operation, name), []).append(figures)
    operations = [judge(operation, name, KINDS[operation], sizes) for (operation, name), sizes in found.items()]
    missed = [f"{each.operation} ({each.axis})" for each in operations if not each.is_within_goal]
    answered = GrowthFigures(operations=operations, missed=missed, filled_s=filled_s)
    return Result(name="growth", ok=not missed, figures=answered, conditions=conditions)
