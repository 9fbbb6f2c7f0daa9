"""The contract language and its machine; touches no clock, file or network.

Discard the host's writes unless `outcome.ok`.
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
