"""A wallet's memory of sharing; the chain does not reveal grantees."""

from __future__ import annotations

import msgspec


class GivenGrant(msgspec.Struct):
    """A grant by this wallet: grantee handle (32 bytes), label, visit and salt opening the chain's hash."""

    grant_id: bytes
    owner: bytes
    handle: bytes
    label: str
    salt: bytes


class SharedCopy(msgspec.Struct):
    """Pictures of a shared record written into a local folder."""

    record_id: bytes
    folder: str


class ReceivedGrant(msgspec.Struct):
    """A grant for this wallet, with key derivation data and written copies.

    `era` numbers the mnemonics from the first; `confirmed` holds `<record id>:<kind>` notices confirmed to the owner.
    """

    grant_id: bytes
    owner: bytes
    ephemeral: bytes
    era: int = 0
    copies: list[SharedCopy] = msgspec.field(default_factory=list)
    confirmed: list[str] = msgspec.field(default_factory=list)
