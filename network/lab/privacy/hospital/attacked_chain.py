"""The attacked chain: shipped contracts in the real executor, without node processes."""

from __future__ import annotations

import asyncio
import secrets
from dataclasses import dataclass
from typing import Any

from consensus.chain.block import Receipt
from consensus.chain.genesis import ChainSettings, Genesis, NodeEntry, Organisation
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.limits import TIME_BUCKET_MS, TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import PrivateKey
from consensus.rights.purposes import PURPOSES
from contracts.execution.executor import execute_block
from contracts.execution.genesis import complete_genesis, open_genesis
from contracts.execution.results import BlockContext
from contracts.lifecycle.registry import contract_entries, load_contracts
from contracts.state.view import MemoryState
from network.sim.world.virtual_time import SimLoop

START_MS = 1_800_000_000_000 - 1_800_000_000_000 % TIME_BUCKET_MS
BLOCK_MS = 40
_BLOCK_TAG = "blockrobot/attacked-block"


@dataclass(frozen=True, slots=True)
class Block:
    """A final block as everyone sees it."""

    height: int
    time_ms: int
    transactions: tuple[Transaction, ...]
    receipts: tuple[Receipt, ...]

    @property
    def block_id(self) -> bytes:
        return tagged_hash(_BLOCK_TAG, self.height.to_bytes(8, "big"))


@dataclass(frozen=True, slots=True)
class Final:
    """A receipt as `clients.robot.delivery.delivery.Confirmation` requires."""

    ok: bool
    code: str


class Chain:
    """A chain on a virtual clock; submissions become final within `BLOCK_MS`."""

    def __init__(self, loop: SimLoop) -> None:
        self._loop = loop
        self.registrar, self.custodian = _draw_key(), _draw_key()
        self.genesis = _build_genesis(self.registrar.public_key, self.custodian.public_key)
        self.chain_id = self.genesis.chain_id
        first = open_genesis(self.genesis)
        self.state = MemoryState()
        self.state.absorb(first.writes, first.pages, first.state_root)
        self.blocks: list[Block] = []
        self._waiting: list[tuple[Transaction, asyncio.Future[Final]]] = []

    def now_ms(self) -> int:
        return START_MS + int(self._loop.now_ms)

    def sign(self, key: PrivateKey, contract: str, entry: str, arguments: list[Any]) -> Transaction:
        return sign_transaction(
            key,
            chain_id=self.chain_id,
            contract=contract,
            entry=entry,
            arguments=arguments,
            valid_until_ms=self.now_ms() + TRANSACTION_LIFETIME_MAX_MS // 2,
            salt=secrets.token_bytes(8),
        )

    async def submit(self, transaction: Transaction) -> Final:
        future: asyncio.Future[Final] = asyncio.get_running_loop().create_future()
        if not self._waiting:
            self._loop.call_later(BLOCK_MS / 1000, self._make_block)
        self._waiting.append((transaction, future))
        return await future

    def _make_block(self) -> None:
        taken, self._waiting = self._waiting, []
        block = self._execute([transaction for transaction, _ in taken])
        receipts = {receipt.txid: receipt for receipt in block.receipts}
        left = []
        for transaction, future in taken:
            receipt = receipts.get(transaction.txid)
            if receipt is None:
                left.append((transaction, future))
            else:
                future.set_result(Final(receipt.ok, receipt.code))
        if left:
            self._waiting = left + self._waiting
            self._loop.call_later(BLOCK_MS / 1000, self._make_block)

    def _execute(self, transactions: list[Transaction]) -> Block:
        height, now_ms = len(self.blocks) + 1, self.now_ms()
        context = BlockContext(chain_id=self.chain_id, height=height, time_ms=now_ms)
        result = execute_block(self.state, load_contracts(), context, transactions, leader=True)
        self.state.absorb(result.writes, result.page_writes, result.state_root)
        done = {receipt.txid for receipt in result.receipts}
        kept = tuple(transaction for transaction in transactions if transaction.txid in done)
        block = Block(height, now_ms, kept, result.receipts)
        self.blocks.append(block)
        return block


def _build_genesis(registrar: bytes, custodian: bytes) -> Genesis:
    node = NodeEntry(
        name="node-1",
        organisation="hospital",
        host="127.0.0.1",
        p2p_port=1,
        api_url="http://127.0.0.1:2",
        producer_key=_draw_key().public_key,
        producer_possession=b"",
        custodian_key=custodian,
    )
    hospital = Organisation(
        name="hospital",
        ca_certificate="",
        admins=(_draw_key().public_key,),
        registrars=(registrar,),
    )
    return complete_genesis(
        Genesis(
            version=1,
            network="attacked",
            created_at_ms=START_MS - 1000,
            settings=ChainSettings(),
            organisations=(hospital,),
            nodes=(node,),
            contracts=contract_entries(),
            purposes=tuple(PURPOSES),
            state_root=b"",
        )
    )


def _draw_key() -> PrivateKey:
    return PrivateKey(secrets.token_bytes(32))
