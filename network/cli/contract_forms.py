"""What a contract on a chain takes: its source and ABI, from where a command can get them. Must never be trusted to decide.

The chain checks every call itself; here the ABI only turns texts into values, and catches mistakes before a signature.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from consensus.errors import BlockRobotError
from contracts.execution.registry import SHIPPED_CONTRACTS, read_source
from contracts.vm import compile_contract
from contracts.vm.abi import Abi


@dataclass(frozen=True, slots=True)
class ContractForm:
    """A contract's source text and its ABI."""

    source: str
    abi: Abi

    def line(self, number: int | None) -> str:
        """Return a line of the source, stripped; an empty text if there is none of this number."""
        lines = self.source.splitlines()
        return lines[number - 1].strip() if number is not None and 0 < number <= len(lines) else ""


def form_of(source: str, name: str) -> ContractForm:
    """Compile a source. Raises CONTRACT_SOURCE_INVALID."""
    return ContractForm(source, compile_contract(source, name).abi)


def find_form(name: str, source_file: Path | None) -> ContractForm:
    """Return the form of a contract: of the file that is named, or of the one that ships under this name.

    Raises TRANSACTION_CONTRACT_UNKNOWN, CONTRACT_SOURCE_INVALID.
    """
    if source_file is not None:
        return form_of(source_file.read_text(encoding="utf-8"), name)
    if name in SHIPPED_CONTRACTS:
        return form_of(read_source(name), name)
    raise BlockRobotError(
        "TRANSACTION_CONTRACT_UNKNOWN", f"There is no contract {name!r} here; give its --source FILE."
    )
