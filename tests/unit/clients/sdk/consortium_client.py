"""A client whose network is a consortium in memory: what it proves is the state, what it sends is executed at once."""

from __future__ import annotations

from collections.abc import Container, Sequence
from types import TracebackType

from clients.sdk.chain.receipts import FinalReceipt, final_receipt
from clients.sdk.chain.transactions import TransactionBuilder
from clients.sdk.connections import NodeAddress
from clients.sdk.proof_checks import ProvedState
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, encode_value
from consensus.primitives.keys import PrivateKey
from contracts.execution.sender_admission import require_admission
from tests.unit.contracts.system.consortium import Consortium


class ConsortiumClient:
    """Stands in for `NetworkClient` in front of `Governor` and the readers."""

    def __init__(self, chain: Consortium, silent: Container[str] = ()) -> None:
        self.chain = chain
        self.transactions = TransactionBuilder(chain.chain_id, self)
        self.silent = silent

    @property
    def nodes(self) -> tuple[NodeAddress, ...]:
        """The active nodes."""
        names = decode_value(self.chain.state.get(b"membership\x00nodes") or encode_value([]))
        return tuple(NodeAddress(name, "http://127.0.0.1:1") for name in names)

    async def ask_node(self, node: NodeAddress, method: str, path: str, *, timeout_ms: int) -> bytes:
        assert (method, path) == ("GET", "/v1/genesis")
        assert timeout_ms > 0
        if node.name in self.silent:
            raise BlockRobotError("NODE_UNREACHABLE", f"Node {node.name} did not answer.")
        return b"{}"

    def now_ms(self) -> int:
        return self.chain.time_ms

    async def __aenter__(self) -> ConsortiumClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None

    async def catch_up(self, key: PrivateKey) -> None:
        if self.chain.state.get(b"identity\x00admin/" + key.public_key) is None:
            raise BlockRobotError("SESSION_REFUSED")

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        assert 1 <= len(keys) <= 128
        data = {flat: self.chain.state.get(flat) for flat in keys}
        values = {flat: None if value is None else decode_value(value) for flat, value in data.items()}
        return ProvedState(height=self.chain.height, timestamp_ms=self.chain.time_ms, values=values)

    async def submit_and_wait(self, transaction: Transaction) -> FinalReceipt:
        require_admission(self.chain.state, transaction, self.chain.time_ms)
        (receipt,) = self.chain.block([transaction])
        return final_receipt(
            receipt, height=self.chain.height, index=0, block_id=bytes(32), timestamp_ms=self.chain.time_ms
        )
