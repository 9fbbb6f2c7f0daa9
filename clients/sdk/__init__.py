"""The client library: build, sign, submit, verify. Must never trust a node."""

from __future__ import annotations

from clients.sdk.announcements import Announcement, AnnouncementPage
from clients.sdk.connections import NodeAddress
from clients.sdk.http import NetworkClient
from clients.sdk.receipts import FinalReceipt
from clients.sdk.transactions import Clock, SystemClock, TransactionBuilder
from clients.sdk.trust import ProvedState

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
