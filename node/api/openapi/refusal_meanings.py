"""Meanings of receipt codes: the machine's, a contract's, or the catalogue's."""

from __future__ import annotations

from consensus.contract_refusals import find_next_step
from consensus.errors import CATALOGUE
from node.api.explorer_documents import RefusalAnswer

_BUDGET = "A budget of the call was spent"
MACHINE_MEANINGS = {
    "OK": "The call did what it was asked to do.",
    "OUT_OF_GAS": f"{_BUDGET}: it took more work than one transaction may.",
    "MEMORY_BUDGET": f"{_BUDGET}: it held too much in memory.",
    "CALL_DEPTH": f"{_BUDGET}: contracts called each other too deeply.",
    "WRITE_BUDGET": f"{_BUDGET}: it wrote too much.",
    "EVENT_BUDGET": f"{_BUDGET}: it emitted too many or too large events.",
    "TYPE_ERROR": "The contract met a value of another type than it can work with.",
    "VALUE_ERROR": "The contract met a value that an operation does not take.",
    "KEY_ERROR": "The contract looked up a key that is not there.",
    "INDEX_ERROR": "The contract looked beyond the end of a list.",
    "ZERO_DIVISION": "The contract divided by zero.",
    "INT_OVERFLOW": "A whole number grew beyond 256 bits.",
    "NAME_UNSET": "The contract read a variable that has no value yet.",
    "ENTRY_UNKNOWN": "The contract has no such entry.",
    "ARGUMENTS_INVALID": "The entry does not take these arguments.",
    "REENTRANT": "A contract was called that was already running in the same call.",
    "VIEW_WRITES": "A view would have changed the state.",
    "LIFECYCLE_ONLY": "The call needs what only the contract `lifecycle` may do.",
}


def explain_refusal(code: str) -> RefusalAnswer:
    """Explain a code; catalogue first, then machine, then shipped contracts."""
    entry = CATALOGUE.get(code)
    if entry is not None:
        return RefusalAnswer(code=code, origin="catalogue", meaning=entry.meaning, next_step=entry.next_step)
    next_step = find_next_step(code, "")
    if code in MACHINE_MEANINGS:
        return RefusalAnswer(code=code, origin="machine", meaning=MACHINE_MEANINGS[code], next_step=next_step)
    meaning = "A rule of the contract refused the call; its own words say which."
    return RefusalAnswer(code=code, origin="contract", meaning=meaning, next_step=next_step)
