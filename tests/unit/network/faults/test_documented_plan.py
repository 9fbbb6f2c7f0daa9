"""The plan and the tables that the how-to shows are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

from network.byzantine import BEHAVIOURS
from network.faults.actions import LINK_PROFILES
from network.faults.plan import parse_plan

PAGE = (Path(__file__).resolve().parents[4] / "docs" / "how-to" / "break-the-network.md").read_text(encoding="utf-8")
NAMES = ("node-1", "node-2", "node-3", "node-4")


def test_the_plan_of_the_how_to_is_a_plan_and_tables_list_every_behaviour_and_profile() -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    plan = parse_plan(text, NAMES)
    assert plan.seed == 7
    assert [step.at_ms for step in plan.steps[:5]] == [2_000, 6_000, 8_000, 9_000, 14_000]
    assert len(plan.steps) == 5 + 2 * 7
    rows = "\n".join(line for line in PAGE.splitlines() if line.startswith("|"))
    assert [name for name in (*BEHAVIOURS, *LINK_PROFILES) if f"`{name}`" not in rows] == []
