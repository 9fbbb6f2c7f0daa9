"""Read proved rows of the state, and run queries over them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol, TypeVar

from clients.sdk.proof_checks import ProvedState
from consensus.api_documents import PROOF_KEYS_MAX_COUNT
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state.keys import DecodedReader, Prefix, Reader, StateKey, UnreadError

T = TypeVar("T")
Read = Callable[[Sequence[bytes]], Awaitable[dict[bytes, Any]]]
"""Returns proved values of any number of flat keys, in one key's session; None for what is absent."""


class ProvingClient(Protocol):
    """What of a `NetworkClient` proves values."""

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        """Return up to 128 proved values of one state."""


async def read_proved(client: ProvingClient, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
    """Read any number of keys, in parts; the height and the time are those of the last part."""
    values: dict[bytes, Any] = {}
    for start in range(0, max(1, len(keys)), PROOF_KEYS_MAX_COUNT):
        part = await client.state_values(keys[start : start + PROOF_KEYS_MAX_COUNT], key)
        values.update(part.values)
    return replace(part, values=values)


def in_session(client: ProvingClient, key: PrivateKey) -> Read:
    async def read(keys: Sequence[bytes]) -> dict[bytes, Any]:
        return (await read_proved(client, keys, key)).values if keys else {}

    return read


async def proved_row(read: Read, rows: Prefix[T], *parts: bytes | str | int) -> T | None:
    return rows.among(await read([rows.key(*parts)]), *parts)


async def proved_rows(read: Read, rows: Prefix[T], ids: Sequence[bytes]) -> list[T]:
    """By id. Raises PROOF_INVALID if one is absent."""
    values = await read([rows.key(each) for each in ids])
    found = [rows.among(values, each) for each in ids]
    if None in found:
        raise BlockRobotError("PROOF_INVALID", f"A row of {rows.name} that has to be there is proved absent.")
    return [row for row in found if row is not None]


async def proved_list(read: Read, count: StateKey[int], numbers: Prefix[bytes]) -> list[bytes]:
    """All ids numbered from 0, in order. Raises PROOF_INVALID on gaps."""
    total = count.among(await read([count.flat])) or 0
    values = await read([numbers.key(number) for number in range(total)])
    return [numbers.convert(values[numbers.key(number)]) for number in range(total)]


async def put_query(read: Read, query: Callable[[Reader], T]) -> T:
    """Run a `consensus.state` query, reading missing values and retrying."""
    values: dict[bytes, Any] = {}
    while True:
        try:
            return query(DecodedReader(values))
        except UnreadError as error:
            (missing,) = error.args
            values.update(await read([missing]))
