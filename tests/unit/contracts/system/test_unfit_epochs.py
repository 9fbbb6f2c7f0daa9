"""A version of `producers` that writes an epoch with which the chain could not go on: its call fails, and no more."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.primitives.encoding import decode_value, encode_value
from consensus.state.producers import EPOCH
from contracts.execution.epochs import is_fit_to_follow
from contracts.lifecycle.registry import read_source
from tests.unit.contracts.system.consortium import Consortium, key_of, producer_of
from tests.unit.contracts.system.deploying import upgrade

ANYONE = key_of("anyone")
SPOILING = '''

@export
def spoil(value: object):
    """Write anything as the epoch."""
    if value is None:
        state.delete(b"epoch")
    else:
        state.put(b"epoch", value)
'''


@pytest.fixture(scope="module")
def chain() -> Consortium:
    chain = Consortium(organisations=3, nodes=4)
    upgrade(chain, "producers", read_source("producers") + SPOILING)
    return chain


def the_next(chain: Consortium, **changes: Any) -> dict[str, Any]:
    value = dict(chain.value("producers", b"epoch"))
    return value | {"number": value["number"] + 1} | changes


def settings(chain: Consortium, **changes: Any) -> dict[str, Any]:
    return dict(chain.value("producers", b"epoch")["settings"]) | changes


WRONG_FIELDS: list[dict[str, Any]] = [
    {"number": True},
    {"number": "1"},
    {"number": 7},
    {"number": -1},
    {"producers": []},
    {"producers": "nobody"},
    {"producers": [b"\x02" * 32]},
    {"producers": [b"\x05" * 33]},
    {"producers": [producer_of("node-01").public_key] * 2},
    {"producers": [key_of(f"producer {number}").public_key for number in range(22)]},
    {"leaderless": None},
    {"leaderless": [4]},
    {"leaderless": [1, 0]},
    {"leaderless": [True]},
    {"settings": None},
    {"settings": {}},
]
WRONG_SETTINGS: list[dict[str, Any]] = [
    {"base_timeout_ms": 49},
    {"base_timeout_ms": 1 << 60},
    {"base_timeout_ms": True},
    {"timeout_cap_ms": "8000"},
    {"heartbeat_ms": 0},
    {"min_block_interval_ms": 500},
    {"max_clock_drift_ms": 0},
    {"blocks_per_turn": 0},
    {"blocks_per_turn": 101},
    {"production": "manual"},
    {"production": "interval:0"},
    {"production": "sometimes"},
    {"another": 1},
]


@pytest.mark.parametrize("changes", WRONG_FIELDS, ids=str)
def test_a_call_that_writes_an_unfit_epoch_fails(chain: Consortium, changes: dict[str, Any]) -> None:
    epoch = chain.epoch
    chain.refused("EPOCH_INVALID", ANYONE, "producers", "spoil", the_next(chain, **changes))
    assert chain.epoch == epoch


@pytest.mark.parametrize("changes", WRONG_SETTINGS, ids=str)
def test_a_call_that_writes_unfit_settings_fails(chain: Consortium, changes: dict[str, Any]) -> None:
    wrong = the_next(chain, settings=settings(chain, **changes))
    chain.refused("EPOCH_INVALID", ANYONE, "producers", "spoil", wrong)


@pytest.mark.parametrize("value", [None, 5, [], "epoch", {}, {b"number": 1}], ids=str)
def test_a_call_that_writes_no_epoch_at_all_fails(chain: Consortium, value: Any) -> None:
    chain.refused("EPOCH_INVALID", ANYONE, "producers", "spoil", value)


def test_an_epoch_may_not_change_without_a_new_number(chain: Consortium) -> None:
    same = dict(chain.value("producers", b"epoch")) | {"leaderless": [0]}
    chain.refused("EPOCH_INVALID", ANYONE, "producers", "spoil", same)
    chain.must(ANYONE, "producers", "spoil", chain.value("producers", b"epoch"))


def test_two_calls_of_one_block_are_held_against_the_epoch_before_it() -> None:
    chain = Consortium(organisations=3, nodes=4)
    upgrade(chain, "producers", read_source("producers") + SPOILING)
    first = the_next(chain, settings=settings(chain, heartbeat_ms=5000))
    again = the_next(chain, settings=settings(chain, heartbeat_ms=6000))
    beyond = the_next(chain, number=first["number"] + 1)
    told = chain.block([chain.sign(ANYONE, "producers", "spoil", value) for value in (first, beyond, again)])
    assert [receipt.code for receipt in told] == ["OK", "EPOCH_INVALID", "OK"]
    assert chain.epoch.settings.heartbeat_ms == 6000
    assert [epoch.number for _, epoch in chain.boundaries] == [first["number"]]
    chain.agree_setting("heartbeat_ms", 7000)


def test_manual_production_may_stay_but_not_begin(chain: Consortium) -> None:
    before = dict(decode_value(chain.state.get(EPOCH.flat) or b""))
    manual = before | {"settings": settings(chain, production="manual")}
    following = manual | {"number": manual["number"] + 1, "leaderless": [0]}
    assert is_fit_to_follow(encode_value(manual), encode_value(following))
    assert not is_fit_to_follow(encode_value(before), encode_value(following))
