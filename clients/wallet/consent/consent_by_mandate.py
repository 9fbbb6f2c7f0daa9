"""Consent statements for another person, by mandate."""

from __future__ import annotations

from dataclasses import dataclass

from clients.wallet.ledger.mandates import Mandate, Mandates
from clients.wallet.ledger.wallet import Wallet


@dataclass(frozen=True, slots=True)
class RepresentedPerson:
    """A person for whom the owner acts: handle, mandate, registering organisation."""

    handle: bytes
    mandate: Mandate
    organisation: str

    @property
    def until_ms(self) -> int:
        """No consent may last longer."""
        return int(self.mandate.state.until_ms)


async def resolve_represented(opened: Wallet, wanted: str | None) -> RepresentedPerson | None:
    """None for oneself. Raises HANDLE_MISTYPED, HANDLE_NOT_FOUND, MANDATE_MISSING."""
    if wanted is None:
        return None
    mandates = Mandates(opened)
    handle = await mandates.read_handle(wanted)
    if handle == opened.store.content.handle:
        return None
    mandate = await mandates.acting_for(handle)
    return RepresentedPerson(handle, mandate, await mandates.organisation_of(handle))


def handle_of(person: RepresentedPerson | None) -> bytes | None:
    return None if person is None else person.handle
