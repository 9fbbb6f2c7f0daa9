"""One lane of the mempool: what waits of each account, and which have most."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import Generic, Protocol, TypeVar


class Waiting(Protocol):
    """What waits: whose it is, and how long it is."""

    @property
    def account(self) -> bytes:
        """In whose turns it is taken."""

    @property
    def is_of_visit(self) -> bool:
        """Whether this is the key, or the grantees, of a visit: one person has many such accounts."""

    @property
    def size_bytes(self) -> int:
        """How many bytes it takes."""


W = TypeVar("W", bound=Waiting)


class Lane(Generic[W]):
    """The queues of all accounts, in the order of their turns.

    Accounts are sorted into classes by the binary length of their size, so that the largest are found, within a factor of
    two, without looking at all.
    """

    def __init__(self) -> None:
        self.queues: OrderedDict[bytes, dict[bytes, W]] = OrderedDict()
        self.size_bytes = 0
        self.size_of_visits_bytes = 0
        self._sizes: dict[bytes, int] = {}
        self._visits: set[bytes] = set()
        self._classes: dict[tuple[int, bool], dict[bytes, None]] = {}

    def add(self, txid: bytes, item: W) -> None:
        """Let one more wait, behind what its account has waiting."""
        queue = self.queues.setdefault(item.account, {})
        if not queue and item.is_of_visit:
            self._visits.add(item.account)
        queue[txid] = item
        self._resize(item.account, item.size_bytes)

    def remove(self, txid: bytes, item: W) -> None:
        """Take one out."""
        queue = self.queues[item.account]
        del queue[txid]
        self._resize(item.account, -item.size_bytes)
        if not queue:
            del self.queues[item.account]
            self._visits.discard(item.account)

    def _resize(self, account: bytes, change_bytes: int) -> None:
        before = self._sizes.get(account, 0)
        after = before + change_bytes
        self.size_bytes += change_bytes
        is_of_visit = account in self._visits
        if is_of_visit:
            self.size_of_visits_bytes += change_bytes
        if before.bit_length() != after.bit_length():
            if before:
                members = self._classes[before.bit_length(), is_of_visit]
                del members[account]
                if not members:
                    del self._classes[before.bit_length(), is_of_visit]
            if after:
                self._classes.setdefault((after.bit_length(), is_of_visit), {})[account] = None
        if after:
            self._sizes[account] = after
        else:
            del self._sizes[account]

    def size_of(self, account: bytes) -> int:
        """Return how many bytes an account has waiting."""
        return self._sizes.get(account, 0)

    @property
    def largest_bytes(self) -> int:
        """How much an account has waiting that has most (within a factor of two)."""
        return self.size_of(next(self.largest(), b""))

    def largest(self, *, of_visits: bool = False) -> Iterator[bytes]:
        """Yield accounts, those that have most first, within a factor of two; among equals visits', and the newest, first.

        `of_visits`: those of visits alone.
        """
        for key in sorted(self._classes, reverse=True):
            if key[1] or not of_visits:
                yield from reversed(self._classes[key])
