"""What a button asks for is read as a plan's step is, and refused with the same words."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.errors import BlockRobotError
from network.byzantine import BEHAVIOURS
from network.faults.actions import FillDisk, GoByzantine, Heal, Kill, Partition, SetLink, Skew
from network.faults.requested import read_action

NAMES = ("node-1", "node-2", "node-3", "node-4")


def _refusal(fields: dict[str, Any]) -> BlockRobotError:
    with pytest.raises(BlockRobotError) as caught:
        read_action(fields, NAMES)
    return caught.value


@pytest.mark.parametrize(
    ("fields", "described"),
    [
        ({"do": "kill", "node": "node-2"}, "kill node-2"),
        ({"do": "restart", "node": "node-2"}, "restart node-2"),
        ({"do": "pause", "node": "node-2"}, "pause node-2"),
        ({"do": "resume", "node": "node-2"}, "resume node-2"),
        ({"do": "partition", "groups": "node-4"}, "partition node-4 | node-1, node-2, node-3"),
        ({"do": "heal"}, "heal everything"),
        ({"do": "heal", "node": "node-3"}, "heal node-3"),
        (
            {"do": "link", "link": "node-1 -> node-2", "profile": "wan"},
            "link node-1 -> node-2: 40-50 ms, 0.1% lost, 6250 kB/s",
        ),
        ({"do": "link", "link": "node-1 <-> node-2"}, "link node-1 <-> node-2: sound"),
        ({"do": "skew", "node": "node-2", "offset": "+1h"}, "skew node-2 by +1h"),
        ({"do": "disk", "node": "node-2", "disk": "ledger"}, "disk of node-2 under its ledger: full"),
        (
            {"do": "disk", "node": "node-2", "disk": "ledger", "full": False},
            "disk of node-2 under its ledger: free again",
        ),
        (
            {"do": "byzantine", "node": "node-4", "behaviour": "equivocate+garbage", "seed": 3},
            "byzantine node-4: equivocate+garbage (seed 3)",
        ),
    ],
)
def test_every_fault_of_the_command_line_can_be_asked_for(fields: dict[str, Any], described: str) -> None:
    action, _seed = read_action(fields, NAMES)
    assert action.describe() == described


def test_the_values_are_those_of_the_command_line_and_a_links_seed_is_handed_on() -> None:
    assert read_action({"do": "kill", "node": "node-1"}, NAMES) == (Kill("node-1"), 0)
    assert isinstance(read_action({"do": "partition", "groups": "node-1"}, NAMES)[0], Partition)
    assert read_action({"do": "heal"}, NAMES)[0] == Heal()
    assert read_action({"do": "skew", "node": "node-1", "offset": "-90s"}, NAMES)[0] == Skew("node-1", -90_000)
    assert read_action({"do": "disk", "node": "node-1", "disk": "journal"}, NAMES)[0] == FillDisk("node-1", "journal")
    lie = read_action({"do": "byzantine", "node": "node-1", "behaviour": next(iter(BEHAVIOURS))}, NAMES)[0]
    assert isinstance(lie, GoByzantine)
    action, seed = read_action({"do": "link", "link": "node-1 -> node-2", "loss": 0.5, "seed": 9}, NAMES)
    assert isinstance(action, SetLink)
    assert (action.fault.loss, seed) == (0.5, 9)


@pytest.mark.parametrize(
    ("fields", "code", "words"),
    [
        ({}, "FAULT_UNKNOWN", "there are kill, restart"),
        ({"do": "explode"}, "FAULT_UNKNOWN", "'explode'"),
        ({"do": ["kill"]}, "FAULT_UNKNOWN", "There is no fault"),
        ({"do": "kill"}, "FAULT_INVALID", "node is missing"),
        ({"do": "kill", "node": "node-9"}, "FAULT_UNKNOWN", "There is no node 'node-9'; there are node-1"),
        ({"do": "kill", "node": "node-1", "hard": True}, "FAULT_INVALID", "kill has no 'hard'"),
        ({"do": "partition", "groups": "node-1,node-2,node-3,node-4"}, "FAULT_INVALID", "two groups or more"),
        ({"do": "partition", "groups": "node-1|node-1"}, "FAULT_INVALID", "stands in two groups"),
        ({"do": "link", "link": "node-1 -> node-1"}, "FAULT_INVALID", "joins two nodes"),
        ({"do": "link", "link": "node-1 -> node-2", "loss": 2}, "FAULT_INVALID", "loss"),
        ({"do": "link", "link": "node-1 -> node-2", "loss": "much"}, "FAULT_INVALID", "not a number"),
        ({"do": "link", "link": "node-1 -> node-2", "seed": -1}, "FAULT_INVALID", "seed"),
        ({"do": "link", "link": "node-1 -> node-2", "seed": "x"}, "FAULT_INVALID", "seed"),
        ({"do": "skew", "node": "node-1", "offset": "soon"}, "FAULT_INVALID", "no duration"),
        ({"do": "disk", "node": "node-1", "disk": "floppy"}, "FAULT_UNKNOWN", "there are journal"),
        ({"do": "byzantine", "node": "node-1", "behaviour": "nice"}, "FAULT_UNKNOWN", "behaviour"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_by_code_and_sentence(fields: dict[str, Any], code: str, words: str) -> None:
    refusal = _refusal(fields)
    assert refusal.code == code
    assert words in refusal.detail
