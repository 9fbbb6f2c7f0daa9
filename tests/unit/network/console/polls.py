"""Looks at a small made-up network, for the tests of this folder."""

from __future__ import annotations

from typing import Any

from network.console.node_polling import NodePoll

NAMES = ("node-1", "node-2", "node-3", "node-4")


def poll(name: str = "node-1", **changes: Any) -> NodePoll:
    """A node that takes part; `status` changes single words of it, None takes them all away."""
    status: dict[str, Any] | None = {
        "ready": True,
        "height": 11,
        "finalized_height": 10,
        "round": 12,
        "epoch": 0,
        "quorum": 3,
        "producers": list(NAMES),
        "leader": "node-1",
        "peers": [other for other in NAMES if other != name],
        "mempool": 0,
        "suspended_height": None,
        "lockout": None,
        "fault": "",
        "rounds": [],
    }
    if "status" in changes:
        said = changes.pop("status")
        status = None if said is None else {**(status or {}), **said}
    fields: dict[str, Any] = {"running": True, "paused": False, "status": status, "switched": {}, "counts": {}}
    return NodePoll(name=name, **{**fields, **changes})


def polls(**changes: dict[str, Any]) -> list[NodePoll]:
    """All four; `node_2={...}` changes one."""
    return [poll(name, **changes.get(name.replace("-", "_"), {})) for name in NAMES]


def stopped() -> dict[str, Any]:
    """What changes when a node is down."""
    return {"running": False, "status": None, "counts": None}


def said(number: int, *words: str, leader: str = "node-1", epoch: int = 0) -> dict[str, Any]:
    """A round in a node's own words."""
    return {"epoch": epoch, "round": number, "leader": leader, "messages": dict.fromkeys(words, 1)}
