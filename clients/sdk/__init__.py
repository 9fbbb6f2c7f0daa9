"""The client library: build, sign, submit, verify. Must never trust a node.

Its names are imported on first use (PEP 562), so that a command that asks no node starts without a client for HTTP.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clients.sdk.announcements import Announcement, AnnouncementPage
    from clients.sdk.connections import NodeAddress
    from clients.sdk.http import NetworkClient
    from clients.sdk.receipts import FinalReceipt
    from clients.sdk.transactions import Clock, SystemClock, TransactionBuilder
    from clients.sdk.trust import ProvedState

_MODULES = {
    "Announcement": "announcements",
    "AnnouncementPage": "announcements",
    "Clock": "transactions",
    "FinalReceipt": "receipts",
    "NetworkClient": "http",
    "NodeAddress": "connections",
    "ProvedState": "trust",
    "SystemClock": "transactions",
    "TransactionBuilder": "transactions",
}

__all__ = [
    "Announcement",
    "AnnouncementPage",
    "Clock",
    "FinalReceipt",
    "NetworkClient",
    "NodeAddress",
    "ProvedState",
    "SystemClock",
    "TransactionBuilder",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
