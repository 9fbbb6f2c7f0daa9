"""Limits of one call: gas, memory, depth, writes, events.

Charges depend on nodes and data sizes, never on a clock or measured memory. Contracts cannot catch exhaustion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn, Protocol

import msgspec

from contracts.vm.model.faults import EVENT_BUDGET, MEMORY_BUDGET, OUT_OF_GAS, VIEW_WRITES, WRITE_BUDGET, Fault

LANGUAGE_VERSION = 5
"""The version of the language: whatever changes a result or a charge raises it, and chains of another one are refused."""

MEMORY_MAX_BYTES = 8 * 1024 * 1024
DEPTH_MAX_FRAMES = 2000
WRITES_MAX_COUNT = 256
GENESIS_WRITES_MAX_COUNT = 16_384
MIGRATE_WRITES_MAX_COUNT = 4_096
EVENTS_MAX_COUNT = 64
ALLOCATION_GAS = 1
ALLOCATION_SHIFT = 9
"""An allocation costs `ALLOCATION_GAS`, and one unit more for each 512 (2 to this power) of its modelled bytes."""


class HostInterface(Protocol):
    """Ledger access: whole flat keys, encoded values and event data."""

    def get(self, key: bytes) -> bytes | None: ...

    def put(self, key: bytes, value: bytes) -> None: ...

    def delete(self, key: bytes) -> None: ...

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        """Return up to `limit` (key, value) pairs in key order."""

    def emit(self, name: str, data: bytes) -> None: ...


class CallContext(msgspec.Struct, frozen=True, gc=False):
    """The transaction and block facts that a contract sees."""

    caller: bytes
    height: int
    time_ms: int
    txid: bytes
    chain_id: bytes


class Runtime:
    """The state of one running call, shared by all contracts it reaches."""

    __slots__ = (
        "calling_contract", "context_values", "contract", "depth", "enter", "events", "gas",
        "host", "judge_source", "memory", "prefix", "read_only", "stack", "writes_left", "writes_max",
    )  # fmt: skip

    def __init__(
        self,
        host: HostInterface,
        context: CallContext,
        gas_limit: int,
        enter: Callable[[Runtime, str, str, list[Any]], Any],
        judge_source: Callable[[bytes], tuple[str, dict[str, Any]]],
        read_only: bool,
        writes_max: int = WRITES_MAX_COUNT,
    ) -> None:
        self.host = host
        self.context_values = (context.caller, context.height, context.time_ms, context.txid, context.chain_id)
        self.gas = gas_limit
        self.enter = enter
        self.judge_source = judge_source
        self.memory = MEMORY_MAX_BYTES
        self.depth = DEPTH_MAX_FRAMES
        self.writes_left = self.writes_max = writes_max
        self.events: list[tuple[str, str, bytes]] = []
        self.read_only = read_only
        self.contract = ""
        self.calling_contract = ""
        self.prefix = b""
        self.stack: list[str] = []

    def charge(self, gas: int) -> None:
        self.gas -= gas
        if self.gas < 0:
            self.exhausted()

    def allocate(self, size: int) -> None:
        """In modelled bytes; gas is 1 plus 1 per 512."""
        self.memory -= size
        self.gas -= ALLOCATION_GAS + (size >> ALLOCATION_SHIFT)
        if self.memory < 0 or self.gas < 0:
            self.exhausted()

    def exhausted(self) -> NoReturn:
        if self.gas < 0:
            raise Fault(OUT_OF_GAS, "The call used up its gas.")
        raise Fault(MEMORY_BUDGET, "The call used up its memory.")

    def check_write(self) -> None:
        if self.read_only:
            raise Fault(VIEW_WRITES, "A view may not change the state.")
        self.writes_left -= 1
        if self.writes_left < 0:
            raise Fault(WRITE_BUDGET, "The call writes to the state more often than a call may.")

    def check_event(self) -> None:
        if self.read_only:
            raise Fault(VIEW_WRITES, "A view may not emit events.")
        if len(self.events) >= EVENTS_MAX_COUNT:
            raise Fault(EVENT_BUDGET, f"A call may emit at most {EVENTS_MAX_COUNT} events.")
