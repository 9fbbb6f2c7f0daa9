"""No call makes the state, a trail or what custodians owe grow for as long as somebody repeats it.

Every entry of the shipped contracts is called many times, each time by another transaction: with the same arguments, and
with every argument new that may be; alone, and with each other entry of its contract after it, which may make room for
the next. Whatever still grows toward the end is named here, with the bound that holds it or why there is none.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import pytest

from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.commitments import derive_record_id
from contracts.execution.call_host import CallHost
from contracts.execution.callers import entry_rules
from contracts.execution.executor import execute_transaction
from contracts.execution.results import PROTOCOL_LIMITS, BlockContext
from contracts.lifecycle.registry import SYSTEM_CONTRACTS
from tests.unit.contracts.privacy import callers as privacy
from tests.unit.contracts.privacy.hospital import key_of
from tests.unit.contracts.system import callers as system

pytestmark = pytest.mark.smoke

KEY_BYTES = 33
TXID_BYTES = 32
CALLS_COUNT = 40
CALLS_TO_NOTICE_COUNT = 12
CALLS_MAX_COUNT = 256 + CALLS_COUNT
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

WITHOUT_END: dict[tuple[str, str], str] = {
    ("consent", "publish_notice"): "an admin's, for the people of the own organisation",
    ("membership", "propose"): "an admin's, who revokes certificates of the own organisation",
    ("records", "open_visit"): "a robot's work",
    ("records", "record"): "a robot's work",
}
"""What only the bytes bound that an account may have nodes keep."""


Path = tuple[Any, ...]
"""Where a single value stands in arguments."""


@dataclass(frozen=True)
class Undo:
    """A call that may make room for the next: it takes the transaction's id before it, or a new value of that one."""

    entry: tuple[str, str]
    key: PrivateKey
    values: list[Any]
    place: Path = ()
    of: Path | None = None

    def after(self, txid: bytes, values: list[Any]) -> list[Any]:
        if not self.place:
            return self.values
        return change(self.values, self.place, lambda _: txid if self.of is None else value_at(values, self.of))


@cache
def scene_of(of_system: bool) -> Any:
    return system.Scene() if of_system else privacy.Scene(privacy.Hospital())


def size_of(host: CallHost) -> int:
    """Return how many bytes keys and values have that were written and are there."""
    return sum(len(key) + len(value) for key, value in host.writes.items() if value is not None)


def freshen(value: Any, number: int) -> Any:
    """Return a value of the same kind and size that no call before had."""
    seed = b"fresh %d" % number
    if isinstance(value, bytes):
        return key_of(seed.decode()).public_key if len(value) == KEY_BYTES else (sha256(seed) * 200)[: len(value)]
    if isinstance(value, str):
        return f"{value}-{number}"
    return value + number if isinstance(value, int) else value


def leaves_of(value: Any, path: Path = ()) -> list[Path]:
    """Return where the single values of arguments stand."""
    if isinstance(value, list | dict):
        places = value.items() if isinstance(value, dict) else enumerate(value)
        return [leaf for place, one in places for leaf in leaves_of(one, (*path, place))]
    return [path]


def value_at(values: Any, path: Path) -> Any:
    return value_at(values[path[0]], path[1:]) if path else values


def change(values: list[Any], path: Path, to: Callable[[Any], Any]) -> list[Any]:
    """Return arguments that differ at one place."""
    changed = copy.deepcopy(values)
    value_at(changed, path[:-1])[path[-1]] = to(value_at(values, path))
    return changed


class Calls:
    """Calls on top of a scene's state, each in a block of its own."""

    def __init__(self, contract: str) -> None:
        scene = scene_of(contract in SYSTEM_CONTRACTS)
        self.chain = scene.chain if contract in SYSTEM_CONTRACTS else scene.hospital
        self.host = CallHost(self.chain.state)
        self.number = 0

    def make(self, place: tuple[str, str], key: PrivateKey, values: list[Any], *, keep: bool = True) -> bytes | None:
        """Call an entry; return the transaction's id if it succeeded."""
        self.number += 1
        if place == ("records", "record"):
            values = [derive_record_id(*values[1:3]), *values[1:]]
        time_ms = self.chain.time_ms + privacy.LATER_MS.get(place, 0) + 100 * self.number
        context = BlockContext(chain_id=self.chain.chain_id, height=self.chain.height + self.number, time_ms=time_ms)
        transaction = self.chain.sign(key, *place, *values)
        receipt = execute_transaction(self.host, self.chain.contracts, context, transaction, PROTOCOL_LIMITS.call_gas)
        if receipt.ok and keep:
            self.host.keep()
        return transaction.txid if receipt.ok else None


def repeat(
    place: tuple[str, str],
    key: PrivateKey,
    values: list[Any],
    calls_count: int,
    fresh: tuple[Path, ...] = (),
    undo: Undo | None = None,
) -> tuple[int, list[int]]:
    """Call an entry so often in as many blocks; return how many calls succeeded, and what was stored after each.

    What stands at the places `fresh` is new each time. `undo` follows each call; it ends when both are refused.
    """
    calls, accepted, sizes = Calls(place[0]), 0, []
    for number in range(1, calls_count + 1):
        now = values
        for path in fresh:
            now = change(now, path, lambda value, n=number: freshen(value, n))
        txid = calls.make(place, key, now)
        accepted += txid is not None
        undone = undo and calls.make(undo.entry, undo.key, undo.after(txid or bytes(32), now))
        sizes.append(size_of(calls.host))
        if undo and not undone and txid is None:
            break
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


def choices_of_fresh(place: tuple[str, str], key: PrivateKey, values: list[Any]) -> list[tuple[Path, ...]]:
    """Return which arguments may be new in each call: all that are taken, each of these, and none."""
    free = tuple(
        path
        for path in leaves_of(values)
        if Calls(place[0]).make(place, key, change(values, path, lambda value: freshen(value, 1)))
    )
    return list(dict.fromkeys([free, *((path,) for path in free), ()]))


def undoings(place: tuple[str, str], values: list[Any], fresh: tuple[Path, ...]) -> Iterator[Undo | None]:
    """Return what may follow an entry: nothing, or whatever of its contract does not grow itself."""
    yield None
    known = {place, *GROWING, *WITHOUT_END}
    for entry in sorted(rule for rule in entry_rules() if rule[0] == place[0] and rule not in known):
        for key, others in rows_of(entry):
            yield Undo(entry, key, others)
            for there in leaves_of(others):
                size = isinstance(value_at(others, there), bytes) and len(value_at(others, there))
                if size == TXID_BYTES:
                    yield Undo(entry, key, others, there)
                for of in fresh:
                    new = value_at(values, of)
                    if size and isinstance(new, bytes) and len(new) == size:
                        yield Undo(entry, key, others, there, of)


def find_without_end(place: tuple[str, str]) -> list[tuple[tuple[Path, ...], Undo | None]]:
    """Return how an entry makes the state grow for longer than any bound of a day allows."""
    found, bounded = [], set()
    for key, values in rows_of(place):
        for fresh in choices_of_fresh(place, key, values):
            for undo in undoings(place, values, fresh):
                how = (place, key, values)
                noticed = repeat(*how, CALLS_TO_NOTICE_COUNT, fresh, undo)[1]
                if (undo and undo.entry in bounded) or len(noticed) < CALLS_TO_NOTICE_COUNT or not grows(noticed):
                    continue
                sizes = repeat(*how, CALLS_MAX_COUNT, fresh, undo)[1]
                if len(sizes) == CALLS_MAX_COUNT and grows(sizes[-CALLS_COUNT:]):
                    found.append((fresh, undo))
                    return found
                bounded.add(undo and undo.entry)
    return found


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


@pytest.mark.parametrize("place", entry_rules(), ids=".".join)
def test_what_is_said_anew_or_undone_and_said_again_stops_growing(place: tuple[str, str]) -> None:
    assert bool(find_without_end(place)) == (place in WITHOUT_END), "bound it by the day, or say why it needs no bound"
