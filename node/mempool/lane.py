"""One lane of the mempool: transactions per account, and the largest accounts."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import Generic, Protocol, TypeVar


class Waiting(Protocol):
    """A waiting transaction: its account and size."""

    @property
    def account(self) -> str: ...

    @property
    def is_of_visit(self) -> bool:
        """Whether the account is a visit's key or grantees; one person has many."""

    @property
    def size_bytes(self) -> int: ...


W = TypeVar("W", bound=Waiting)


class Lane(Generic[W]):
    """Queues of accounts in turn order, classed by their size's bit length."""

    def __init__(self) -> None:
        self.queues: OrderedDict[str, dict[bytes, W]] = OrderedDict()
        self.size_bytes = 0
        self.size_of_visits_bytes = 0
        self._sizes: dict[str, int] = {}
        self._visits: set[str] = set()
        self._classes: dict[tuple[int, bool], dict[str, None]] = {}

    def add(self, txid: bytes, item: W) -> None:
        queue = self.queues.setdefault(item.account, {})
        if not queue and item.is_of_visit:
            self._visits.add(item.account)
        queue[txid] = item
        self._resize(item.account, item.size_bytes)

    def remove(self, txid: bytes, item: W) -> None:
        queue = self.queues[item.account]
        del queue[txid]
        self._resize(item.account, -item.size_bytes)
        if not queue:
            del self.queues[item.account]
            self._visits.discard(item.account)

    def _resize(self, account: str, change_bytes: int) -> None:
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

    def size_of(self, account: str) -> int:
        return self._sizes.get(account, 0)

    @property
    def largest_bytes(self) -> int:
        """Bytes waiting of the largest account (within a factor of two)."""
        return self.size_of(next(self.largest(), ""))

    def largest(self, *, of_visits: bool = False) -> Iterator[str]:
        """Yield accounts, largest first within a factor of two; `of_visits`: only visits."""
        for key in sorted(self._classes, reverse=True):
            if key[1] or not of_visits:
                yield from reversed(self._classes[key])
