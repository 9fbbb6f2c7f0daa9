"""Empty frames a robot may publish: proved reads, approval and withdrawal."""

from __future__ import annotations

from collections.abc import Sequence

from clients.sdk.chain.proved_rows import in_session, proved_row
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.network_client import NetworkClient
from consensus.limits import EMPTY_FRAMES_A_CALL_MAX_COUNT
from consensus.primitives.keys import PrivateKey
from consensus.state.records import EMPTY_FRAMES, EmptyFrameRow

ROBOT_FILE = "robot.txt"
PREVIEW_FILE = "preview.png"
"""Next to the pictures, in a folder of frames that wait for approval: whose they are, and all in one picture."""


async def read_approved(client: NetworkClient, robot: bytes, reader: PrivateKey) -> list[EmptyFrameRow]:
    """Oldest first."""
    return await proved_row(in_session(client, reader), EMPTY_FRAMES, robot) or []


async def approve_frames(
    client: NetworkClient, approver: PrivateKey, robot: bytes, frames: Sequence[bytes]
) -> FinalReceipt | None:
    """Return the last receipt, None if no frame is new."""
    known = {frame.digest for frame in await read_approved(client, robot, approver)}
    wanted = [frame for frame in dict.fromkeys(frames) if frame not in known]
    return await _decide(client, approver, "approve_empty_frames", robot, wanted)


async def withdraw_frames(
    client: NetworkClient, key: PrivateKey, robot: bytes, frames: Sequence[bytes]
) -> FinalReceipt | None:
    """Custodians delete frames that no robot has left."""
    return await _decide(client, key, "withdraw_empty_frames", robot, list(dict.fromkeys(frames)))


async def _decide(
    client: NetworkClient, key: PrivateKey, entry: str, robot: bytes, frames: Sequence[bytes]
) -> FinalReceipt | None:
    receipt = None
    for start in range(0, len(frames), EMPTY_FRAMES_A_CALL_MAX_COUNT):
        chosen = list(frames[start : start + EMPTY_FRAMES_A_CALL_MAX_COUNT])
        receipt = await client.call(key, "records", entry, [robot, chosen])
    return receipt
