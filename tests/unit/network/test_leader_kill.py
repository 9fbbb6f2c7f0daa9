"""Who is killed in the demonstration: the node that most nodes say is leading."""

from __future__ import annotations

from typing import Any

import pytest

from network.cluster import NodeStatusReport
from network.demo.leader_kill import find_leader


class Watched:
    """A cluster of which only the nodes' own words are known."""

    names = ("node-1", "node-2", "node-3", "node-4")

    def __init__(self, leaders: tuple[str | None, ...]) -> None:
        self._leaders = leaders

    async def status(self) -> list[NodeStatusReport]:
        return [
            NodeStatusReport(name, leader is not None, None if leader is None else self._said(leader))
            for name, leader in zip(self.names, self._leaders, strict=True)
        ]

    @staticmethod
    def _said(leader: str) -> dict[str, Any]:
        return {"leader": leader, "finalized_height": 1}


@pytest.mark.parametrize(
    ("leaders", "expected"),
    [
        (("node-3", "node-3", "node-3", "node-3"), "node-3"),
        (("node-3", "node-4", "node-4", None), "node-4"),
        ((None, None, None, "node-2"), "node-2"),
        ((None, None, None, None), "node-1"),
        (("", "", "", "node-2"), "node-2"),
    ],
    ids=["all agree", "one lags and one is dead", "one is left", "none answers", "three do not know"],
)
async def test_the_leader_is_the_one_that_most_name(leaders: tuple[str | None, ...], expected: str) -> None:
    assert await find_leader(Watched(leaders)) == expected  # type: ignore[arg-type]
