"""The contract language and its machine: sources in, outcomes out. Must never touch a clock, a file or the network.

    contract = compile_contract(source, "records")        # ContractSourceError lists what is wrong, by line
    outcome = invoke({"records": contract}, "records", "record", [record_id, owner], host=host,
                     context=CallContext(caller, height, time_ms, txid, chain_id), gas_limit=250_000, mode="export")
    if outcome.ok: ...                                     # else outcome.code, .message, .line; discard host writes

`host` implements `HostInterface` over flat keys and encoded values. `contract.abi` describes the entries.
"""

from __future__ import annotations

from contracts.vm.compiler.compiled_contract import CompiledContract, compile_contract, find_problems
from contracts.vm.compiler.invoke import Outcome, invoke
from contracts.vm.frontend.abi import Abi, Entry
from contracts.vm.model.faults import VM_CODES, ContractSourceError, Diagnostic, InternalFault
from contracts.vm.model.meter import LANGUAGE_VERSION, CallContext, HostInterface

__all__ = [
    "LANGUAGE_VERSION",
    "VM_CODES",
    "Abi",
    "CallContext",
    "CompiledContract",
    "ContractSourceError",
    "Diagnostic",
    "Entry",
    "HostInterface",
    "InternalFault",
    "Outcome",
    "compile_contract",
    "find_problems",
    "invoke",
]
