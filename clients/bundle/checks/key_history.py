"""A person's past and present keys, proved by transactions."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from clients.bundle import documents as doc
from clients.bundle.checks.chain_proofs import ProvedChain
from clients.bundle.layout import KEY_HISTORY
from consensus.chain.genesis import Genesis
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.state.identity import MemberRow

CONTRACT = "identity"
REGISTERED, ROTATED = "registered", "rotated"
_ENTRIES = {"register": REGISTERED, "rotate": ROTATED}
STEPS_MAX_COUNT = 1_000


@dataclass(frozen=True, slots=True)
class KeyStep:
    """A key change; `before` is empty at registration."""

    handle: bytes
    before: bytes
    member: bytes
    sealing: bytes


def _unproven(detail: str) -> BlockRobotError:
    return BlockRobotError("BUNDLE_UNPROVEN", detail)


def read_step(transaction: Transaction) -> KeyStep:
    """Raises BUNDLE_UNPROVEN."""
    body = transaction.body
    if body.contract != CONTRACT or body.entry not in _ENTRIES:
        raise _unproven("What should prove former keys is no registration and no rotation.")
    arguments: list[Any] = decode_value(body.args)
    if body.entry == "register":
        return KeyStep(arguments[0], b"", body.sender, arguments[7])
    return KeyStep(arguments[0], body.sender, arguments[1], arguments[4])


def prove_sealing_keys(
    chain: ProvedChain, genesis: Genesis, history: doc.KeyHistory, member: bytes, row: MemberRow
) -> tuple[bytes, ...]:
    """Return proved sealing keys, oldest first. Raises BUNDLE_UNPROVEN unless linked to `member`."""
    if not 1 <= len(history.steps) <= STEPS_MAX_COUNT:
        raise BlockRobotError("BUNDLE_INVALID", f"{KEY_HISTORY} has no steps, or too many.")
    steps = [_prove_step(chain, genesis, step) for step in history.steps]
    for (place, earlier), (following, later) in itertools.pairwise(steps):
        if place >= following or earlier.member != later.before:
            raise _unproven("The rotations of a person's keys do not follow each other.")
    last = steps[-1][1]
    if last.member != member or any(step.handle != row.handle for _, step in steps):
        raise _unproven("The rotations of keys are not those of the person whom the bundle names.")
    if row.sealing not in {last.sealing, b""}:  # who has left has none any more
        raise _unproven("The rotations of keys do not lead to the key that the person has.")
    return tuple(step.sealing for _, step in steps)


def _prove_step(chain: ProvedChain, genesis: Genesis, step: doc.KeyChange) -> tuple[tuple[int, int], KeyStep]:
    transaction = decode_transaction(doc.read_bytes(KEY_HISTORY, step.transaction))
    transaction.verify_sender()
    proved = chain.receipt(KEY_HISTORY, step.proof)
    key_step = read_step(transaction)
    is_right = transaction.body.chain_id == genesis.chain_id and proved.receipt.txid == transaction.txid
    if not is_right or not proved.receipt.ok:
        raise _unproven("A rotation of keys is not what the ledger took.")
    return (proved.height, proved.index), key_step


def own_steps(events: Sequence[tuple[bytes, str, dict[str, Any]]], member: bytes) -> list[bytes]:
    """Ids, oldest first."""
    before = {data["new_member"]: (txid, data["member"]) for txid, name, data in events if name == ROTATED}
    registered = {data["member"]: txid for txid, name, data in events if name == REGISTERED}
    found: list[bytes] = []
    while member in before and len(found) < STEPS_MAX_COUNT:
        txid, member = before[member]
        found.append(txid)
    if member in registered:
        found.append(registered[member])
    return found[::-1]
