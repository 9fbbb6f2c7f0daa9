"""Words of consent for another person, by a mandate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import click

from clients.wallet.ledger.mandates import Mandate, Mandates
from clients.wallet.ledger.wallet import Wallet


@dataclass(frozen=True, slots=True)
class Represented:
    """For whom one speaks: the handle, the mandate, and the organisation that registered the person."""

    handle: bytes
    mandate: Mandate
    organisation: str

    @property
    def until_ms(self) -> int:
        """When the mandate ends: no consent under it may last longer."""
        return int(self.mandate.state.until_ms)

    def as_json(self) -> dict[str, Any]:
        """Return it for a program."""
        return {"for": self.handle.hex(), "mandate_id": self.mandate.mandate_id.hex()}


FOR_ONESELF: dict[str, Any] = {"for": None, "mandate_id": None}
"""What a program is told where one speaks for oneself."""


def for_option(command: Any) -> Any:
    """Add `--for HANDLE` to a command."""
    option = click.option("--for", "whom", help="For a person who cannot, by a mandate: the handle, whole or in short.")
    return option(command)


async def find_represented(opened: Wallet, wanted: str | None) -> Represented | None:
    """Return for whom one speaks, None for oneself (nobody named).

    Raises HANDLE_MISTYPED, HANDLE_NOT_FOUND, MANDATE_MISSING.
    """
    if wanted is None:
        return None
    mandates = Mandates(opened)
    handle = await mandates.read_handle(wanted)
    if handle == opened.store.content.handle:
        return None
    mandate = await mandates.acting_for(handle)
    return Represented(handle, mandate, await mandates.organisation_of(handle))


def handle_of(person: Represented | None) -> bytes | None:
    """Return the handle of the person for whom one speaks, None for oneself."""
    return None if person is None else person.handle
