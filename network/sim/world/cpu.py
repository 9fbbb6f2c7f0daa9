"""What a simulated node's work takes of its one core, in microseconds of virtual time.

The prices are those of `COSTS`; `blockrobot sim calibrate` measures the same on a real machine. Whatever is charged while
an owner's code runs keeps its core busy: what is due meanwhile waits, and what it sends leaves when the work is done.
They are kept apart from the prices by which a node budgets its own work: a wrong price there has to show here.
"""

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
    """Microseconds of one core: each is what `blockrobot sim calibrate` calls by the same name.

    `frame`: a frame cut out of the stream and handed on; `kib`: 1 KiB decrypted, encrypted or copied. `signature`: one
    checked; `signing`: one made. `transaction`: one decoded, with the checks that take no elliptic curve. `execution`:
    one executed; `block`: what a block takes besides. `request`: one answered, and `range_kib` 1 KiB of stored blocks
    read for it. `call`: one HTTP request of a client.
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
    """Let the core of whoever runs be busy for so long. Free while no run charges, and for the stage."""
    if _loops:
        _loops[-1].occupy(cost_us / 1_000_000 / CORE_SHARE)


@contextmanager
def charging(loop: SimLoop) -> Iterator[None]:
    """Charge for what owners of this loop do, also for each key that a transaction's check recovers."""

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
    """One node's cache: it pays for what it sees first, though another node of the process checked it already."""

    def __init__(self, shared: TransactionCache) -> None:
        super().__init__()
        self._shared = shared

    def get(self, wire: bytes) -> Transaction | None:
        """See `TransactionCache.get`. One that is not known has to be decoded."""
        known = super().get(wire)
        if known is None:
            charge(COSTS.transaction)
            known = self._shared.get(wire)
            if known is not None:
                charge(COSTS.signature)
                super().add(known)
        return known

    def verified(self, wire: bytes) -> Transaction:
        """See `TransactionCache.verified`."""
        return self.get(wire) or super().verified(wire)

    def add(self, transaction: Transaction) -> None:
        """See `TransactionCache.add`."""
        super().add(transaction)
        self._shared.add(transaction)


class NodeCheck:
    """One node's `SignatureCheck`: it pays for each signature once, though another node checked it already."""

    def __init__(self, shared: SignatureCheck) -> None:
        self._shared = shared
        self._genuine: set[tuple[object, ...]] = set()

    def __call__(self, public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool:
        """Return True for a genuine signature."""
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
