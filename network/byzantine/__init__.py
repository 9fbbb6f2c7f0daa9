"""Deliberately Byzantine producers that lie, stay silent or flood.

Each behaviour replaces the outbox of an honest production node and signs with its genuine key. Behaviours do no I/O and
draw chance only from a seeded `random.Random`, so simulations replay. Join several with `+`.
"""

from __future__ import annotations

from network.byzantine.behaviour import TICK_MS, Behaviour, ColludingNodes, OwnNode
from network.byzantine.catalogue import BEHAVIOURS, byzantine_clock, check_behaviour, make_behaviour

__all__ = [
    "BEHAVIOURS",
    "TICK_MS",
    "Behaviour",
    "ColludingNodes",
    "OwnNode",
    "byzantine_clock",
    "check_behaviour",
    "make_behaviour",
]
