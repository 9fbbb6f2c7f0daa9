"""CPU costs of a simulated node's one core, in virtual microseconds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from consensus.chain import transaction as transaction_module
from consensus.chain.signature_cache import SignatureCheck
from consensus.chain.transaction import Transaction
from consensus.primitives.keys import recover
from network.sim.world.virtual_time import SimLoop
from node.mempool.transaction_cache import TransactionCache

SIGNATURES_MAX_COUNT = 65_536


class Costs(NamedTuple):
    """Microseconds of one core, named as in `blockrobot sim calibrate`.

    `kib`: 1 KiB decrypted, encrypted or copied; `transaction`: decoded, without elliptic-curve checks; `block`: besides
    executions; `range_kib`: 1 KiB of stored blocks read.
    """

    frame: float = 4.0
    kib: float = 0.4
    signature: float = 48.0
    signing: float = 45.0
    transaction: float = 15.0
    execution: float = 260.0
    block: float = 15.0
    request: float = 8.0
    range_kib: float = 3.0
    call: float = 170.0


COSTS = Costs()
CORE_SHARE = 0.5
"""How much of such a core a node has: four share the two of the machine on which the prices were measured."""

_loops: list[SimLoop] = []


def charge(cost_us: float) -> None:
    """Keep the running owner's core busy. Free outside charged runs and for the stage."""
    if _loops:
        _loops[-1].occupy(cost_us / 1_000_000 / CORE_SHARE)


@contextmanager
def charging(loop: SimLoop) -> Iterator[None]:
    def recover_and_charge(tag: str, signature: bytes, *parts: bytes) -> bytes:
        charge(COSTS.signature)
        return recover(tag, signature, *parts)

    _loops.append(loop)
    vars(transaction_module)["recover"] = recover_and_charge
    try:
        yield
    finally:
        vars(transaction_module)["recover"] = recover
        _loops.pop()


class NodeTransactions(TransactionCache):
    """A node's transaction cache: it pays even where another node checked first."""

    def __init__(self, shared: TransactionCache) -> None:
        super().__init__()
        self._shared = shared

    def get(self, wire: bytes) -> Transaction | None:
        known = super().get(wire)
        if known is None:
            charge(COSTS.transaction)
            known = self._shared.get(wire)
            if known is not None:
                charge(COSTS.signature)
                super().add(known)
        return known

    def verified(self, wire: bytes) -> Transaction:
        return self.get(wire) or super().verified(wire)

    def add(self, transaction: Transaction) -> None:
        super().add(transaction)
        self._shared.add(transaction)


class NodeCheck:
    """A node's `SignatureCheck`: it pays once for each signature."""

    def __init__(self, shared: SignatureCheck) -> None:
        self._shared = shared
        self._genuine: set[tuple[object, ...]] = set()

    def __call__(self, public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool:
        place = (public_key, tag, signature, parts)
        if place in self._genuine:
            return True
        charge(COSTS.signature)
        genuine = self._shared(public_key, tag, signature, *parts)
        if genuine:
            if len(self._genuine) >= SIGNATURES_MAX_COUNT:
                self._genuine.clear()
            self._genuine.add(place)
        return genuine
