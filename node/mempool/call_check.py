"""Rejects submitted calls that cannot succeed by the finalized state."""

from __future__ import annotations

from collections.abc import Callable

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.state.keys import Reader
from consensus.state.lifecycle import MACHINE_TABLE
from contracts.lifecycle.changed_calls import explain_misfit
from contracts.lifecycle.describing import NamedVersion, active_contract, read_version

ROWS_KEPT_COUNT = 128
_Known = tuple[NamedVersion, bool, int]


class CallCheck:
    """Checks calls against the interfaces of the contracts in force, cached per table."""

    def __init__(self, reader: Callable[[], Reader]) -> None:
        """`reader` gives the newest finalized state."""
        self._reader = reader
        self._table: bytes | None = None
        self._known: dict[str, _Known | None] = {}

    def require(self, transaction: Transaction) -> None:
        """Raises CONTRACT_DISABLED, CONTRACT_CALL_OUTDATED; unknown contracts pass."""
        state, body = self._reader(), transaction.body
        known = self._find(state, body.contract)
        if known is None:
            return
        row, enabled, since_height = known
        if not enabled:
            raise BlockRobotError(
                "CONTRACT_DISABLED", f"The contract {row.name} is disabled since height {since_height}."
            )
        misfit = explain_misfit(state, row, since_height, body.entry, transaction.arguments())
        if misfit is not None:
            raise BlockRobotError("CONTRACT_CALL_OUTDATED", f"{misfit[0]}: {misfit[1]}")

    def _find(self, state: Reader, name: str) -> _Known | None:
        table = state.get(MACHINE_TABLE.flat)
        if table != self._table or len(self._known) >= ROWS_KEPT_COUNT:
            self._table, self._known = table, {}
        if name not in self._known:
            self._known[name] = _look_up(state, name)
        return self._known[name]


def _look_up(state: Reader, name: str) -> _Known | None:
    """Return what is known of a contract, or None; unreadable interfaces reject nothing."""
    row = active_contract(state, name)
    try:
        return None if row is None else (read_version(state, name, row.version), row.enabled, row.since_height)
    except BlockRobotError:
        return None
