"""Work costs in estimated microseconds of CPU: every frame, request and route."""

from __future__ import annotations

from collections.abc import Mapping

EC_OPERATION_US = 100
"""One signature verified or one key recovered, with the hash before it."""
TRANSACTION_SCREENING_US = 80
"""Decoding a transaction, and all checks that need no elliptic curve."""
BYTES_PER_US = 512
"""Reading, decrypting and copying."""
FRAME_US = 8
"""Cutting any frame out of the stream and handing it on."""
READ_US = 20
"""Reading from a connection what ends no frame."""
RECORD_US = 1
"""Opening any record of TLS."""
REFUSAL_US = 150
"""Answering that a request is refused."""

ROUTE_DEFAULT_US = 500
"""A plain request, with all that HTTP takes."""
STRAY_US = ROUTE_DEFAULT_US
"""An answer that is of no route: no such path or method, or no HTTP at all."""
ROUTE_COSTS: Mapping[str, int] = {
    "getGenesis": ROUTE_DEFAULT_US,
    "getOpenApi": ROUTE_DEFAULT_US,
    "submitTransactions": 500,
    "getTransaction": ROUTE_DEFAULT_US,
    "createSessionChallenge": 600,
    "createSession": 1_000,
    "deleteSession": 400,
    "getFinality": ROUTE_DEFAULT_US,
    "getEpochs": ROUTE_DEFAULT_US,
    "getHeaders": 1_000,
    "proveState": 3_000,
    "proveNotices": 5_000,
    "signConsentReceipt": 2_000,
    "queryContract": 3_000,
    "listAnnouncements": 1_000,
    "streamEvents": 1_000,
    "listEvents": 1_000,
    "downloadSharedClip": 3_000,
    "uploadKeyPart": 2_000,
    "uploadClip": 3_000,
    "downloadClip": ROUTE_DEFAULT_US,
    "putBackground": 3_000,
    "getBackground": ROUTE_DEFAULT_US,
    "listBlocks": 1_000,
    "getBlock": 1_000,
    "listContracts": ROUTE_DEFAULT_US,
    "getContract": ROUTE_DEFAULT_US,
    "getExplorerStatus": ROUTE_DEFAULT_US,
    "listExplorerHeaders": ROUTE_DEFAULT_US,
    "getExplorerHeader": ROUTE_DEFAULT_US,
    "getExplorerEpoch": ROUTE_DEFAULT_US,
    "listExplorerProducers": ROUTE_DEFAULT_US,
    "explainRefusal": ROUTE_DEFAULT_US,
    "redirectToExplorer": ROUTE_DEFAULT_US,
    "getExplorer": ROUTE_DEFAULT_US,
    "getExplorerFile": ROUTE_DEFAULT_US,
    "getSharedFile": ROUTE_DEFAULT_US,
}
"""By operation, what is paid before a request begins. What it turns out to take beyond that is measured and paid too."""


def bytes_cost_us(size_bytes: int) -> int:
    return size_bytes // BYTES_PER_US
