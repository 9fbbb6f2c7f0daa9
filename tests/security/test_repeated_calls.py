"""No call makes the state, a trail or what custodians owe grow for as long as somebody repeats it.

Every entry of the shipped contracts is called many times with the same valid arguments, each time by another transaction.
Whatever still grows toward the end is named here, with the bound that holds it.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from consensus.primitives.keys import PrivateKey
from contracts.execution.call_host import CallHost
from contracts.execution.callers import entry_rules
from contracts.execution.executor import execute_transaction
from contracts.execution.registry import SYSTEM_CONTRACTS
from contracts.execution.results import PROTOCOL_LIMITS, BlockContext
from tests.unit.contracts.privacy import callers as privacy
from tests.unit.contracts.system import callers as system

pytestmark = pytest.mark.smoke

CALLS_COUNT = 40
GROWTH_MIN_BYTES = 16
GROWING: dict[tuple[str, str], int] = {
    ("access", "request"): 256,
    ("access", "verdict"): 256,
    ("access", "grant"): 64,
    ("access", "request_granted"): 64,
    ("access", "noticed"): 256,
    ("officers", "propose"): 64,
    ("rights", "assess"): 64,
    ("rights", "object_to_release"): 256,
    ("rights", "rectify"): 256,
    ("rights", "restrict"): 256,
}
"""How often what grows is accepted on one day: counted by the contracts `audit`, `access`, `officers` and `rights`."""


@cache
def scene_of(of_system: bool) -> Any:
    return system.Scene() if of_system else privacy.Scene(privacy.Hospital())


def size_of(host: CallHost) -> int:
    """Return how many bytes keys and values have that were written and are there."""
    return sum(len(key) + len(value) for key, value in host.writes.items() if value is not None)


def repeat(place: tuple[str, str], key: PrivateKey, values: list[Any], calls_count: int) -> tuple[int, list[int]]:
    """Call an entry so often in as many blocks; return how many calls succeeded, and what was stored after each."""
    scene = scene_of(place[0] in SYSTEM_CONTRACTS)
    chain = scene.chain if place[0] in SYSTEM_CONTRACTS else scene.hospital
    host, accepted, sizes = CallHost(chain.state), 0, []
    delay_ms = privacy.LATER_MS.get(place, 0)
    for number in range(1, calls_count + 1):
        time_ms = chain.time_ms + delay_ms + 100 * number
        context = BlockContext(chain_id=chain.chain_id, height=chain.height + number, time_ms=time_ms)
        transaction = chain.sign(key, *place, *values)
        receipt = execute_transaction(host, chain.contracts, context, transaction, PROTOCOL_LIMITS.call_gas)
        if receipt.ok:
            host.keep()
            accepted += 1
        sizes.append(size_of(host))
    return accepted, sizes


def rows_of(place: tuple[str, str]) -> list[tuple[PrivateKey, list[Any]]]:
    """Return who may call an entry, with which arguments: one caller for each row."""
    of_system = place[0] in SYSTEM_CONTRACTS
    scene = scene_of(of_system)
    rules = system.RULES if of_system else privacy.RULES
    allowed = [(arguments, sorted(names)) for *entry, arguments, names in rules if tuple(entry) == place and names]
    return [(scene.everyone[name], arguments(scene)) for arguments, names in allowed for name in names]


def grows(sizes: list[int]) -> bool:
    """Tell whether the later half of the calls still made it grow."""
    half = len(sizes) // 2
    return sizes[-1] - sizes[half - 1] >= half * GROWTH_MIN_BYTES


@pytest.mark.parametrize("place", entry_rules(), ids=".".join)
def test_what_is_said_again_and_again_stops_growing(place: tuple[str, str]) -> None:
    growing = False
    for key, values in rows_of(place):
        accepted, sizes = repeat(place, key, values, CALLS_COUNT)
        assert accepted, place
        growing = growing or grows(sizes)
    assert growing == (place in GROWING), "name it with its bound, or mend it"


@pytest.mark.parametrize("place", GROWING, ids=".".join)
def test_what_grows_is_refused_from_its_bound_on(place: tuple[str, str]) -> None:
    for key, values in rows_of(place)[:1]:
        accepted, sizes = repeat(place, key, values, GROWING[place] + CALLS_COUNT)
        assert accepted <= GROWING[place]
        assert not grows(sizes[-CALLS_COUNT:])
