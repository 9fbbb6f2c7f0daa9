"""The console offers what the command line offers: no fault of one is missing from the other."""

from __future__ import annotations

import re
from typing import Any, get_args

from network.cli.cluster.fault_commands import fault
from network.console.live import CONSOLE_ASSETS
from network.faults.actions import Action
from network.faults.plan import STEP_FIELDS
from network.faults.requested import read_action

NAMES = ("node-1", "node-2")
BESIDE_FAULTS = {"list", "run"}
"""Commands that break nothing by themselves: the console has a table of nodes and a form for plans."""
ASKED: dict[str, dict[str, Any]] = {
    "kill": {"node": "node-1"},
    "restart": {"node": "node-1"},
    "pause": {"node": "node-1"},
    "resume": {"node": "node-1"},
    "partition": {"groups": "node-1"},
    "heal": {},
    "link": {"link": "node-1 -> node-2", "cut": True},
    "skew": {"node": "node-1", "offset": "+1h"},
    "disk": {"node": "node-1", "disk": "journal"},
    "byzantine": {"node": "node-1", "behaviour": "garbage"},
}


def test_the_console_takes_each_fault_of_the_command_line_and_has_something_to_press_for_it() -> None:
    assert set(STEP_FIELDS) == set(fault.commands) - BESIDE_FAULTS
    made = {type(read_action({"do": kind, **fields}, NAMES)[0]) for kind, fields in ASKED.items()}
    assert made == set(get_args(Action))
    page = (CONSOLE_ASSETS / "faults.js").read_text(encoding="utf-8")
    assert set(re.findall(r'\bdo: "(\w+)"', page)) == set(STEP_FIELDS)
