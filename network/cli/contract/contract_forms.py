"""Sources and ABIs of on-chain contracts; the chain still checks each call."""

from __future__ import annotations

from dataclasses import dataclass

from clients.sdk.network_client import NetworkClient
from consensus.primitives.keys import PrivateKey
from consensus.visible_text import split_lines
from contracts.vm import compile_contract
from contracts.vm.frontend.abi import Abi
from network.contracts.chain_contracts import read_edition


@dataclass(frozen=True, slots=True)
class ContractForm:
    """A contract's source text and its ABI."""

    source: str
    abi: Abi

    def line(self, number: int | None) -> str:
        """Return a stripped source line, empty if out of range."""
        lines = split_lines(self.source)
        return lines[number - 1].strip() if number is not None and 0 < number <= len(lines) else ""


def form_of(source: str, name: str) -> ContractForm:
    """Compile a source. Raises CONTRACT_SOURCE_INVALID."""
    return ContractForm(source, compile_contract(source, name).abi)


async def find_form(client: NetworkClient, key: PrivateKey, name: str, source: str | None) -> ContractForm:
    """Return the form of the given source, or of the active version, proved.

    Raises CONTRACT_NOT_FOUND, CONTRACT_SOURCE_INVALID.
    """
    if source is not None:
        return form_of(source, name)
    return form_of((await read_edition(client, key, name, 0)).source, name)
