"""What the page has asked access for: a look at a meeting, in however many parts, is one request on the chain.

The page names each look by a random text of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.records.viewing import Viewing

LOOKS_MAX_COUNT = 32
LOOK_NAME_MAX_CHARS = 64


class Looks:
    """The access requests of one page, by look and purpose; the look that is used least recently is forgotten."""

    def __init__(self) -> None:
        self._requests: dict[tuple[str, str], dict[bytes, bytes]] = {}

    async def request(
        self, viewing: Viewing, look: str, purpose: str, entries: Sequence[RecordEntry]
    ) -> dict[bytes, bytes]:
        """Return an access id for each record; ask on the chain for those for which this look has none."""
        known = self._requests.pop((look, purpose), {})
        if look:
            self._requests[look, purpose] = known
            while len(self._requests) > LOOKS_MAX_COUNT:
                del self._requests[next(iter(self._requests))]
        missing = [entry for entry in entries if entry.record_id not in known]
        for part in await viewing.split_requests(missing):
            access_id = await viewing.request_access(part, purpose)
            known |= {entry.record_id: access_id for entry in part}
        return known

    def forget(self, look: str) -> None:
        """Forget what was asked for in one look: custodians take it no more."""
        for key in [key for key in self._requests if key[0] == look]:
            del self._requests[key]

    def forget_all(self) -> None:
        """Forget every look."""
        self._requests.clear()
