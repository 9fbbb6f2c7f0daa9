"""What a wallet remembers of sharing, in its encrypted file alone.

The chain does not say with whom something was shared: an owner's wallet restored from its words still shows every grant,
but no longer for whom it was.
"""

from __future__ import annotations

import msgspec


class GivenGrant(msgspec.Struct):
    """A grant that this wallet made: to whom (handle of 32 bytes, and what its owner calls her), of which visit.

    The salt shows, to whom it is told, that the hash on the chain is of this handle.
    """

    grant_id: bytes
    owner: bytes
    handle: bytes
    label: str
    salt: bytes


class SharedCopy(msgspec.Struct):
    """Pictures of a shared record that were written into a folder of this machine."""

    record_id: bytes
    folder: str


class ReceivedGrant(msgspec.Struct):
    """A grant that this wallet found to be for it: what derives its key again, and where its pictures were written.

    `era` says which of the wallet's words it was made for, counted from its first. `confirmed` says of which records,
    after which notices (`<record id>:<kind>`), the owner was told that copies are gone.
    """

    grant_id: bytes
    owner: bytes
    ephemeral: bytes
    era: int = 0
    copies: list[SharedCopy] = msgspec.field(default_factory=list)
    confirmed: list[str] = msgspec.field(default_factory=list)
