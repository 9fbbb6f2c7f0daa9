"""Producers that lie, stay silent or flood, on purpose.

Each behaviour is one class that stands where the engine's outbox stands: the node below it is the production code and
believes itself honest; what leaves it is what a dishonest producer would say, signed with its genuine key. No behaviour
does I/O or draws chance of its own: chance comes from a seeded `random.Random`, so that a simulator replays it.

    name                  what the others see
    equivocate            two genuine blocks in one round, each to one half, with a vote for each
    double-vote           two votes in one round: for the block, and for another one (an accomplice's, if there is one)
    withhold-votes        no votes; everything else as it should be
    withhold-blocks       votes, but never its block: its rounds are lost
    partial-proposals     its block goes to some only: the others must fetch it from them
    stale-certificates    timeouts and proposals that deny all newer certificates, and notices of old ones
    forged-certificates   certificates with too few, doubled, moved or wrongly made signatures
    wrong-epochs          words of epochs that are over or to come, and old quorums' certificates as of now
    wrong-roots           blocks whose roots or gas are not what their transactions give
    time-limit            blocks stamped as far ahead as the chain's settings allow
    garbage               a bounded flood: bytes that are no message, and messages that are nearly right

Several at once are named with `+`: `equivocate+garbage`.

    clock = byzantine_clock("time-limit", clock, drift_ms)      # before the node is made: behaviours may bend its clock
    outbox = make_behaviour("equivocate", inner=peers, own=view, key=key, chance=Random(7))
    engine.start(outbox)                                        # and outbox.tick() every TICK_MS

`own` says what a liar may look at of its own node (`OwnNode`; `EngineView` makes one of a running engine). Nodes that
conspire share one `Accomplices`. `python -m network.byzantine.process` runs a real node of this kind.
"""

from __future__ import annotations

from network.byzantine.behaviour import TICK_MS, Accomplices, Behaviour, OwnNode
from network.byzantine.catalogue import BEHAVIOURS, byzantine_clock, check_behaviour, make_behaviour

__all__ = [
    "BEHAVIOURS",
    "TICK_MS",
    "Accomplices",
    "Behaviour",
    "OwnNode",
    "byzantine_clock",
    "check_behaviour",
    "make_behaviour",
]
