"""Evaluates contract views on one version of the state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from contracts.execution.call_host import CallHost
from contracts.execution.results import BlockContext
from contracts.lifecycle.catalogue import ActiveContracts, Catalogue
from contracts.lifecycle.changed_calls import ARGUMENTS_INVALID, CONTRACT_DISABLED, explain_absence
from contracts.lifecycle.registry import require_contracts
from contracts.state.view import StateReader
from contracts.vm import CallContext, CompiledContract, invoke

VIEW_GAS_MAX = 2_000_000


def run_view(
    state: StateReader,
    contracts: Mapping[str, CompiledContract],
    context: BlockContext,
    contract: str,
    view: str,
    arguments: list[Any],
    *,
    caller: bytes = bytes(33),
    gas_limit: int = VIEW_GAS_MAX,
) -> Any:
    """`context` is that of the newest block.

    Raises TRANSACTION_CONTRACT_UNKNOWN, CONTRACT_DISABLED or CALL_REFUSED with the contract's code.
    """
    compiled = contracts.get(contract)
    if compiled is None:
        code, sentence = explain_absence(contracts, contract)
        known = code == CONTRACT_DISABLED
        raise BlockRobotError(CONTRACT_DISABLED if known else "TRANSACTION_CONTRACT_UNKNOWN", sentence)
    if not any(entry.name == view and entry.kind == "view" for entry in compiled.abi.entries):
        detail = f"There is no view {contract}.{view}.{_in_force(contracts, contract)}"
        raise BlockRobotError("TRANSACTION_CONTRACT_UNKNOWN", detail)
    call = CallContext(
        caller=caller, height=context.height, time_ms=context.time_ms, txid=bytes(32), chain_id=context.chain_id
    )
    outcome = invoke(
        contracts, contract, view, arguments, host=CallHost(state), context=call, gas_limit=gas_limit, mode="view"
    )
    if not outcome.ok:
        version = _in_force(contracts, contract) if outcome.code == ARGUMENTS_INVALID else ""
        raise BlockRobotError("CALL_REFUSED", f"The view refused: {outcome.code}: {outcome.message}{version}")
    return outcome.result


def _in_force(contracts: Mapping[str, CompiledContract], name: str) -> str:
    if not isinstance(contracts, ActiveContracts):
        return ""
    return f" Version {contracts.versions[name]} of {name} is active since height {contracts.since[name]}."


class ContractViews:
    """Runs views with the contracts that the state names."""

    def __init__(self, genesis: Genesis) -> None:
        """Raises GENESIS_INVALID if the first contracts differ from those shipped here."""
        require_contracts(genesis)
        self._chain_id = genesis.chain_id
        self._catalogue = Catalogue()

    def load(self, state: StateReader) -> None:
        self._catalogue.active(state)

    def run(
        self, state: StateReader, height: int, time_ms: int, contract: str, view: str, arguments: list[Any]
    ) -> bytes:
        """Encoded; time in ms.

        Raises TRANSACTION_CONTRACT_UNKNOWN (or unknown view), CONTRACT_DISABLED, CALL_REFUSED.
        """
        context = BlockContext(chain_id=self._chain_id, height=height, time_ms=time_ms)
        return encode_value(run_view(state, self._catalogue.active(state), context, contract, view, arguments))
