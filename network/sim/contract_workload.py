"""Simulated organisations' contract decisions, deterministic by number as `network.sim.workload`."""

from __future__ import annotations

from functools import cache
from typing import Any

from consensus.chain.transaction import Transaction
from contracts.lifecycle.registry import compute_source_hash, read_source
from network.sim.plan import NetworkSize
from network.sim.workload import Call, sign_call
from network.sim.world.sim_chain import Chain, make_chain

GUESTS = '''
EDITION = NUMBER


@export
def write(text: str):
    """Keep a line, in the form of this edition."""
    require(state.get(b"edition", EDITION) == EDITION, "EDITION_WRONG", "The state has another form.")
    state.put(b"edition", EDITION)
    state.put(b"line/" + text.encode(), [EDITION, ctx.height])


@migrate
def carry_over():
    """Bring all lines into the form of this edition."""
    state.put(b"edition", EDITION)
    for key, line in state.scan(b"line/", 100):
        state.put(key, [EDITION, line[1]])
'''
PART_BYTES = 6000


def _decide(chain: Chain, kind: str, arguments: dict[str, Any], number: int) -> list[tuple[Call, ...]]:
    proposal = sign_call(chain, chain.admins[0], "lifecycle", "propose", [kind, arguments], number)
    approval = sign_call(chain, chain.admins[-1], "lifecycle", "approve", [proposal.txid], number)
    return [(Call(proposal),), (Call(approval),)]


def _deploy(chain: Chain, name: str, source: str, number: int) -> list[tuple[Call, ...]]:
    data, source_hash = source.encode(), compute_source_hash(source)
    parts = [data[first : first + PART_BYTES] for first in range(0, len(data), PART_BYTES)]
    uploads = tuple(
        Call(sign_call(chain, chain.admins[0], "lifecycle", "upload", [source_hash, len(parts), place, part], number))
        for place, part in enumerate(parts)
    )
    check = Call(sign_call(chain, chain.admins[0], "lifecycle", "check_upload", [source_hash], number))
    arguments = {"name": name, "source_hash": source_hash, "height": 0, "delay": number % 3, "note": ""}
    return [uploads, (check,), *_decide(chain, "deploy", arguments, number)]


def _write(chain: Chain, number: int, place: int, *excused: str) -> tuple[Call, ...]:
    transaction: Transaction = sign_call(chain, chain.registrar, "guests", "write", [f"{number} {place}"], number)
    return (Call(transaction, excused=excused),)


@cache
def contract_turnover(size: NetworkSize, number: int) -> tuple[tuple[Call, ...], ...]:
    """Return batches: contract deployment or upgrade with migration, disabling, re-enabling."""
    chain = make_chain(size)
    batches = _deploy(chain, "guests", GUESTS.replace("NUMBER", str(number + 1)), number)
    early = ("CONTRACT_UNKNOWN", "CONTRACT_DISABLED")
    batches += [_write(chain, number, place, *early) for place in range(2)]
    if number % 2:
        batches += _deploy(chain, "settings", f"{read_source('settings')}\n# Edition {number}.\n", number)
        proposal = sign_call(chain, chain.admins[0], "settings", "propose", ["heartbeat_ms", 20_000 + number], number)
        approval = sign_call(chain, chain.admins[-1], "settings", "approve", [proposal.txid], number)
        batches += [(Call(proposal),), (Call(approval),)]
    when = {"height": 0, "delay": 0, "note": ""}
    batches += _decide(chain, "disable", {"name": "guests", "version": number + 1} | when, number)
    batches += _decide(chain, "activate", {"name": "guests", "version": max(1, number)} | when, number)
    batches += [_write(chain, number, 2, *early)]
    return tuple(batches)
