"""The author's kit: write, test and inspect contracts."""

from __future__ import annotations

from contracts.kit.chain import Called, Caller, CallFailedError, Chain, Contract, Event
from contracts.kit.tracing import Trace

__all__ = ["CallFailedError", "Called", "Caller", "Chain", "Contract", "Event", "Trace"]
