"""The client of a network: asks several nodes, believes none.

Whatever fails at one node for a reason that another might not have is tried at the next. A node's word alone is
good for two things only: the result of `query`, and that a transaction is *not* final.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import Any, TypeVar

import msgspec

from clients.sdk.chain.announcements import AnnouncementPage, read_announcements
from clients.sdk.chain.custody_client import CustodyClient
from clients.sdk.chain.proved_rows import PROOF_KEYS_MAX_COUNT
from clients.sdk.chain.receipts import FinalReceipt, not_final_in_time
from clients.sdk.chain.transactions import Clock, SystemClock, TransactionBuilder
from clients.sdk.connections import (
    NO_LANE,
    REQUEST_TIMEOUT_MS,
    Connections,
    NodeAddress,
)
from clients.sdk.failover import BY_ITS_CLOCK, NOT_TAKING_PART, failure_of, may_ask_another
from clients.sdk.known_nodes import STEPS_MAX_COUNT, NodeDirectory, read_known_nodes
from clients.sdk.node_answers import (
    EpochsAnswer,
    FinalityAnswer,
    ProofsAnswer,
    QueryAnswer,
    SubmitAnswer,
    TransactionAnswer,
    error_of,
    read_answer,
    read_hex,
)
from clients.sdk.proof_checks import ProofVerifier, ProvedState
from clients.sdk.sessions import Sessions
from clients.sdk.trust_pin import open_pin, write_pin
from consensus.chain.block import Header
from consensus.chain.genesis import Genesis
from consensus.chain.schedule import Schedule
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, encode_value
from consensus.primitives.keys import PrivateKey

WAIT_SLICE_MS = 5_000
FROZEN_AFTER_MS = 4_000
"""A node that keeps a transaction, or the question for it, waiting for longer is passed over: asking twice is harmless."""
WAIT_DEFAULT_MS = 30_000
ANNOUNCEMENTS_PAGE_MAX_COUNT = 200
PASS_PAUSE_MS = 100
CATCH_UP_TIMEOUT_MS = 3_000
PASSES_MAX_COUNT = 20
T = TypeVar("T")

__all__ = ["FinalReceipt", "NetworkClient"]

_NO_WAIT_HELPS = BY_ITS_CLOCK | {"BLOCK_PRUNED", "CONTRACT_DISABLED", "CONTRACT_CALL_OUTDATED"}
"""What stays so for a transaction after every node has said it, or until organisations decide otherwise."""


class NetworkClient:
    """A client of one network. Use as an async context manager, or call `close`.

    Without `urls` the client asks the network's nodes: at first those of the genesis file, then those that the proved
    state names. It looks again by itself when it reads in somebody's session. With `urls` (names to addresses) it asks
    those nodes and no others. `first` names the node to begin with.
    `pinned` is what the property `pinned` was last time: the newest header that this client has verified, the epochs
    that led there, and the nodes it knew. When the network's producers change, the client follows by itself. `troubles`
    holds, by name, why a node was passed over; one that served since is not in it.
    """

    def __init__(
        self,
        genesis: Genesis,
        urls: Mapping[str, str] | None = None,
        *,
        pinned: bytes | None = None,
        clock: Clock | None = None,
        first: str | None = None,
    ) -> None:
        """Raises CONFIGURATION_INVALID for addresses that are none, unknown nodes, or plain HTTP beyond loopback."""
        self.genesis = genesis
        self.clock = clock or SystemClock()
        self.transactions = TransactionBuilder(genesis.chain_id, self.clock)
        self.light_client, known = open_pin(genesis, pinned)
        self._trust = ProofVerifier(genesis, self.light_client)
        self._book = NodeDirectory(genesis, urls, known)
        self._connections = Connections()
        self._sessions = Sessions(genesis.chain_id, self._connections, self.clock)
        self._first = first
        self._is_finding = False
        self.troubles: dict[str, BlockRobotError] = {}
        self.custody = CustodyClient(lambda: self._book.custodians, self.ask_node, self.state_values)

    async def __aenter__(self) -> NetworkClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close every connection."""
        await self._connections.close()

    async def forget_key(self, public_key: bytes) -> None:
        """Drop the sessions of a key and close its connections."""
        self._sessions.forget_key(public_key)
        await self._connections.close_lane(public_key)

    @property
    def pinned(self) -> bytes:
        """What to persist and give to the next client: no node can show it an older state, and it finds the nodes."""
        return write_pin(self.light_client, self._book.known)

    @property
    def nodes(self) -> tuple[NodeAddress, ...]:
        """The nodes that are asked, as far as this client knows; that may change while it runs."""
        return self._book.addresses

    # Who is there

    async def find_nodes(self, key: PrivateKey) -> None:
        """Learn from the proved state which nodes there are, in the session of `key`, if it is time to.

        Reading does this by itself. A client that only submits may call it now and then. What cannot be learned now
        is learned later: the nodes that are known go on being asked.
        """
        if self._is_finding or not self._book.is_due(self._trust.epoch, self.clock.now_ms()):
            return
        self._is_finding = True
        try:
            await self._learn_nodes(key)
        except BlockRobotError:
            # A key without a session learns nothing, nor does anybody from nodes that are all away.
            self._book.note_learned(self._trust.epoch, self.clock.now_ms())
        finally:
            self._is_finding = False

    async def _learn_nodes(self, key: PrivateKey) -> None:
        """Ask until nothing new is heard: a node that was removed still names those who were there when it went."""
        for _ in range(STEPS_MAX_COUNT):
            found = await read_known_nodes(partial(self._read_values, key=key), self._book.known)
            self._book.note_learned(self._trust.epoch, self.clock.now_ms())
            if not self._book.learn(found):
                return

    # Asking

    async def ask_node(
        self,
        node: NodeAddress,
        method: str,
        path: str,
        *,
        key: PrivateKey | None = None,
        lane: bytes = NO_LANE,
        body: bytes | None = None,
        media_type: str = "application/json",
        query: Mapping[str, str | int] | None = None,
        timeout_ms: int = REQUEST_TIMEOUT_MS,
    ) -> bytes:
        """Make one request to one node, in the session of `key` if one is given (on that key's own connections).

        A session that is over is opened again, once. Raises what the node refuses with.
        """
        if key is None:
            return await self._connections.request(
                node, method, path, lane=lane, body=body, media_type=media_type, query=query, timeout_ms=timeout_ms
            )
        for attempt in (1, 2):
            token = await self._sessions.token(node, key, min(timeout_ms, REQUEST_TIMEOUT_MS))
            try:
                return await self._connections.request(
                    node,
                    method,
                    path,
                    lane=key.public_key,
                    body=body,
                    media_type=media_type,
                    query=query,
                    token=token,
                    timeout_ms=timeout_ms,
                )
            except BlockRobotError as error:
                if error.code not in {"SESSION_EXPIRED", "SESSION_REFUSED"} or attempt == 2:
                    raise
                self._sessions.forget(node, key, token)
        raise AssertionError("a loop of two attempts ends by answer or error")

    async def with_any_node(self, work: Callable[[NodeAddress], Awaitable[T]], *, is_doubted: bool = False) -> T:
        """Do the work with one node after another until one does it; begin with the one that served last.

        Raises the first refusal that no other node could help with, or what `failure_of` says of them all. Where a
        refusal `is_doubted`, since a node may lie or lag, one more node than may be faulty has to give it.
        """
        failures: list[BlockRobotError] = []
        believed_count = 1 + (Schedule.of(self.light_client.epoch).faults_tolerated if is_doubted else 0)
        for node in self._in_turn():
            try:
                result = await self._through_epochs(node, work)
            except BlockRobotError as error:
                failures.append(error)
                if may_ask_another(error):
                    self._note_trouble(node, error)
                elif sum(other.code == error.code for other in failures) >= believed_count:
                    raise
                continue
            self._first = node.name
            self.troubles.pop(node.name, None)
            return result
        raise failure_of(failures)

    def _note_trouble(self, node: NodeAddress, error: BlockRobotError) -> None:
        self.troubles[node.name] = error
        if error.code in {"NODE_UNREACHABLE", *NOT_TAKING_PART}:
            self._book.note_failure()

    def _in_turn(self) -> tuple[NodeAddress, ...]:
        """Return the nodes, beginning with the one that served last."""
        nodes = self._book.addresses
        start = next((index for index, node in enumerate(nodes) if node.name == self._first), 0)
        return (*nodes[start:], *nodes[:start])

    async def _through_epochs(self, node: NodeAddress, work: Callable[[NodeAddress], Awaitable[T]]) -> T:
        """Do the work; while its proofs are of later epochs, follow the chain there by what the same node can prove."""
        while True:
            entered = self._trust.epoch
            try:
                return await work(node)
            except BlockRobotError as error:
                if error.code != "PROOF_OTHER_EPOCH":
                    raise
                if not await self._follow_epochs(node) and self._trust.epoch == entered:
                    raise

    async def _follow_epochs(self, node: NodeAddress) -> bool:
        """Fetch the next steps through the epochs, on a connection of no key; tell whether they led further."""
        content = await self.ask_node(node, "GET", "/v1/epochs", query={"after": self._trust.epoch})
        return self._trust.follow(read_answer(content, EpochsAnswer))

    async def _ask_until_fresh(self, work: Callable[[NodeAddress], Awaitable[T]]) -> T:
        """As `with_any_node`, but give nodes that lag behind what this client has seen a moment to catch up."""
        for _ in range(PASSES_MAX_COUNT - 1):
            try:
                return await self.with_any_node(work)
            except BlockRobotError as error:
                if error.code != "PROOF_STALE":
                    raise
                await asyncio.sleep(PASS_PAUSE_MS / 1000)
        return await self.with_any_node(work)

    # Transactions

    async def submit(self, transaction: Transaction) -> bytes:
        """Hand a transaction to one node (it tells the others) and return its txid.

        Raises why it was rejected, once more nodes than may be faulty have said so.
        """

        async def submit_to(node: NodeAddress) -> bytes:
            (error,) = await self._submit_to(node, [transaction])
            if error is not None:
                raise error
            return transaction.txid

        return await self.with_any_node(submit_to, is_doubted=True)

    async def submit_batch(self, transactions: Sequence[Transaction]) -> list[BlockRobotError | None]:
        """Hand up to 256 transactions to one node; for each return None, or why this node rejected it.

        They travel on the first sender's connections: do not mix senders that must not be seen together.
        """
        if not transactions:
            return []
        return await self.with_any_node(lambda node: self._submit_to(node, transactions))

    async def _submit_to(self, node: NodeAddress, transactions: Sequence[Transaction]) -> list[BlockRobotError | None]:
        body = msgspec.msgpack.encode([transaction.wire for transaction in transactions])
        sender = transactions[0].body.sender
        token = self._sessions.open_token(node, sender)  # strangers of this address do not hold up a session
        content = await self._connections.request(
            node,
            "POST",
            "/v1/transactions",
            lane=sender,
            body=body,
            token=token,
            media_type="application/msgpack",
            timeout_ms=FROZEN_AFTER_MS,
        )
        results = read_answer(content, SubmitAnswer).results
        if len(results) != len(transactions):
            raise BlockRobotError("INTERNAL", f"Node {node.name} answered for another number of transactions.")
        # A transaction that is already known was accepted before: sending it twice is how a client stays safe.
        return [
            None if result.error is None or result.error.code == "TRANSACTION_REPLAYED" else error_of(result.error)
            for result in results
        ]

    async def wait_final(
        self, txid: bytes, timeout_ms: int = WAIT_DEFAULT_MS, *, lane: bytes = NO_LANE
    ) -> FinalReceipt:
        """Wait until a transaction is final and return its proved receipt. `lane` names the key whose lane to use.

        Raises TRANSACTION_NOT_FINAL_IN_TIME, TRANSACTION_EXPIRED.
        """
        deadline_ms = self.clock.now_ms() + timeout_ms
        while True:
            left_ms = deadline_ms - self.clock.now_ms()
            if left_ms <= 0:
                raise not_final_in_time(txid)
            slice_ms = min(left_ms, WAIT_SLICE_MS)
            started_ms = self.clock.now_ms()
            try:
                receipt = await self.with_any_node(partial(self._look_up, txid=txid, wait_ms=slice_ms, lane=lane))
            except BlockRobotError as error:
                if error.code in _NO_WAIT_HELPS or not may_ask_another(error):
                    raise
                receipt = None
            if receipt is not None:
                return receipt
            if self.clock.now_ms() - started_ms < min(slice_ms, PASS_PAUSE_MS):
                await asyncio.sleep(PASS_PAUSE_MS / 1000)

    async def _look_up(self, node: NodeAddress, txid: bytes, wait_ms: int, lane: bytes) -> FinalReceipt | None:
        """Ask one node for a transaction; return None while it is not final there. Raises TRANSACTION_EXPIRED."""
        content = await self.ask_node(
            node,
            "GET",
            f"/v1/transactions/{txid.hex()}",
            lane=lane,
            query={"wait_ms": wait_ms, "evidence": 1},
            timeout_ms=wait_ms + FROZEN_AFTER_MS,
        )
        answer = read_answer(content, TransactionAnswer)
        if answer.status == "expired":
            raise BlockRobotError("TRANSACTION_EXPIRED", txid=txid.hex())
        if answer.status != "finalized" or answer.evidence is None or answer.index is None:
            return None
        return self._trust.receipt(answer.evidence, txid, answer.index)

    async def submit_and_wait(self, transaction: Transaction, timeout_ms: int = WAIT_DEFAULT_MS) -> FinalReceipt:
        """Submit a transaction and wait for its proved receipt, sending it to other nodes while it is not final.

        Safe to call again with the same transaction: it takes effect once. Raises why every node rejected it,
        TRANSACTION_EXPIRED, or TRANSACTION_NOT_FINAL_IN_TIME (then it may still become final: look it up).
        """
        deadline_ms = self.clock.now_ms() + timeout_ms
        accepted = False
        while True:
            try:
                await self.submit(transaction)
                accepted = True
            except BlockRobotError as error:
                is_final = error.code in _NO_WAIT_HELPS or not may_ask_another(error)
                if not accepted and is_final:
                    return await self._final_after_rejection(transaction, error)
            left_ms = deadline_ms - self.clock.now_ms()
            if left_ms <= 0:
                raise not_final_in_time(transaction.txid)
            try:
                return await self.wait_final(
                    transaction.txid, min(left_ms, WAIT_SLICE_MS), lane=transaction.body.sender
                )
            except BlockRobotError as error:
                if error.code != "TRANSACTION_NOT_FINAL_IN_TIME":
                    raise
            # The node that took it may be cut off from the others: begin with the next one.
            self._first = self._in_turn()[1 % len(self.nodes)].name

    async def _final_after_rejection(self, transaction: Transaction, error: BlockRobotError) -> FinalReceipt:
        """A transaction that was final before (and has expired since) is no failure: look before raising."""
        try:
            receipt = await self.with_any_node(
                lambda node: self._look_up(node, transaction.txid, 0, transaction.body.sender)
            )
        except BlockRobotError:
            raise error from None
        if receipt is None:
            raise error
        return receipt

    async def call(
        self,
        key: PrivateKey,
        contract: str,
        entry: str,
        arguments: list[Any],
        *,
        timeout_ms: int = WAIT_DEFAULT_MS,
    ) -> FinalReceipt:
        """Build, sign, submit and wait; return the receipt of a call that succeeded. Raises CALL_REFUSED and the like."""
        transaction = self.transactions.build(key, contract, entry, arguments)
        return replace((await self.submit_and_wait(transaction, timeout_ms)).require_ok(), transaction=transaction)

    # Reading

    async def newest_header(self, key: PrivateKey) -> Header:
        """Return the newest finalized header that a node can prove. Raises PROOF_STALE if all lag."""

        async def ask(node: NodeAddress) -> Header:
            answer = read_answer(await self.ask_node(node, "GET", "/v1/finality", key=key), FinalityAnswer)
            return self._trust.finality(answer.finality)

        await self.find_nodes(key)
        return await self._ask_until_fresh(ask)

    async def catch_up(self, key: PrivateKey) -> Header:
        """Return the newest header that any node proves final, and begin with that node from now on.

        One node alone may be cut off and not know it. From then on no older state is taken from any of them. Raises
        NODE_UNREACHABLE and the like if none answers.
        """

        await self.find_nodes(key)
        nodes = self.nodes
        asked = [self._through_epochs(node, partial(self.node_header, key=key)) for node in nodes]
        answers = await asyncio.gather(*asked, return_exceptions=True)
        failures = [answer for answer in answers if isinstance(answer, BaseException)]
        for failure in failures:
            if not isinstance(failure, BlockRobotError) or len(failures) == len(answers):
                raise failure
        heights = [-1 if isinstance(answer, BaseException) else answer.height for answer in answers]
        self._first = nodes[heights.index(max(heights))].name
        return self.light_client.header

    async def node_header(self, node: NodeAddress, key: PrivateKey) -> Header:
        """Return the newest header that this one node proves final, and pin it. Raises PROOF_STALE if it lags."""
        content = await self.ask_node(node, "GET", "/v1/finality", key=key, timeout_ms=CATCH_UP_TIMEOUT_MS)
        return self._trust.finality(read_answer(content, FinalityAnswer).finality)

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        """Return the proved values of up to 128 flat keys, all from one finalized state, in the session of `key`.

        Raises VALUE_INVALID beyond 128 keys, PROOF_INVALID if no node can prove them, PROOF_STALE if all nodes lag
        behind what this client has verified before.
        """
        if not 1 <= len(keys) <= PROOF_KEYS_MAX_COUNT:
            raise BlockRobotError("VALUE_INVALID", f"One proof is for 1 to {PROOF_KEYS_MAX_COUNT} keys.")
        await self.find_nodes(key)
        return await self._read_values(keys, key)

    async def _read_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        body = msgspec.json.encode({"keys": [flat.hex() for flat in keys]})

        async def ask(node: NodeAddress) -> ProvedState:
            content = await self.ask_node(node, "POST", "/v1/state-proofs", key=key, body=body)
            return self._trust.values(read_answer(content, ProofsAnswer), keys)

        return await self._ask_until_fresh(ask)

    async def prove_public(
        self, asking: Callable[[NodeAddress], Awaitable[bytes]], keys: Sequence[bytes]
    ) -> ProvedState:
        """Return what a question without a session proves of these keys. Raises PROOF_*, and what nodes refuse with."""

        async def ask(node: NodeAddress) -> ProvedState:
            return self._trust.values(read_answer(await asking(node), ProofsAnswer), keys)

        return await self._ask_until_fresh(ask)

    async def state_value(self, flat: bytes, key: PrivateKey) -> Any:
        """Return the proved value of one flat key, or None if it is absent."""
        return (await self.state_values([flat], key)).values[flat]

    async def query(self, contract: str, view: str, arguments: list[Any], key: PrivateKey) -> Any:
        """Return what one node says a view returns: convenient, but not proved. Raises CALL_REFUSED and the like."""
        document = {"contract": contract, "view": view, "args": encode_value(arguments).hex()}
        body = msgspec.json.encode(document)
        content = await self.with_any_node(lambda node: self.ask_node(node, "POST", "/v1/queries", key=key, body=body))
        return decode_value(read_hex(read_answer(content, QueryAnswer).result))

    async def announcements(
        self, first: int, key: PrivateKey, limit: int = ANNOUNCEMENTS_PAGE_MAX_COUNT
    ) -> AnnouncementPage:
        """Return the announcements from number `first` on, at most `limit` (up to 200), proved to be complete.

        `page.next_number < page.count` tells that there are more.
        """
        if first < 0 or not 1 <= limit <= ANNOUNCEMENTS_PAGE_MAX_COUNT:
            raise BlockRobotError("VALUE_INVALID", f"A page has 1 to {ANNOUNCEMENTS_PAGE_MAX_COUNT} announcements.")

        async def ask(node: NodeAddress) -> AnnouncementPage:
            query = {"from": first, "limit": limit}
            content = await self.ask_node(node, "GET", "/v1/announcements", key=key, query=query)
            return read_announcements(self._trust, read_answer(content, ProofsAnswer), first, limit)

        await self.find_nodes(key)
        return await self._ask_until_fresh(ask)
