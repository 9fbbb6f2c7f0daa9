"""Network client trusting no single node, except for `query` results and that a transaction is not final."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import msgspec

from clients.sdk.chain.announcements import AnnouncementPage, read_announcements
from clients.sdk.chain.custody_client import CustodyClient
from clients.sdk.chain.receipts import FinalReceipt, not_final_in_time
from clients.sdk.chain.transactions import Clock, SystemClock, TransactionBuilder
from clients.sdk.connections import (
    ANONYMOUS_LANE,
    REQUEST_TIMEOUT_MS,
    Connections,
    NodeAddress,
)
from clients.sdk.given_nodes import GIVEN_TIMEOUT_MS, Claim, GivenNode, read_claim, use_given_nodes
from clients.sdk.known_nodes import STEPS_MAX_COUNT, KnownCustodian, NodeDirectory, read_known_nodes
from clients.sdk.new_files import replace_file
from clients.sdk.node_answers import (
    BY_ITS_CLOCK,
    NOT_TAKING_PART,
    error_of,
    failure_of,
    may_ask_another,
    read_answer,
    read_hex,
)
from clients.sdk.proof_checks import ProofVerifier, ProvedState
from clients.sdk.sessions import Sessions
from clients.sdk.trust_pin import open_pin, read_pin, write_pin
from consensus.api_documents import (
    ANNOUNCEMENTS_PAGE_MAX_COUNT,
    PROOF_KEYS_MAX_COUNT,
    EpochsAnswer,
    FinalityAnswer,
    ProofsAnswer,
    ProofsRequest,
    QueryAnswer,
    QueryRequest,
    SubmitAnswer,
    TransactionState,
)
from consensus.chain.block import Header
from consensus.chain.genesis import Genesis, genesis_from_json
from consensus.chain.schedule import Schedule
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, encode_value
from consensus.primitives.keys import PrivateKey

WAIT_SLICE_MS = 5_000
FROZEN_AFTER_MS = 4_000
"""A node that keeps a transaction, or the question for it, waiting for longer is passed over: asking twice is harmless."""
WAIT_DEFAULT_MS = 30_000
PASS_PAUSE_MS = 100
CATCH_UP_TIMEOUT_MS = 3_000
PASSES_MAX_COUNT = 20
BUDGET_WAIT_MS = 1_000
BUDGET_WAITS_MAX_COUNT = 5
"""When all nodes refuse because this client asked too much, as one may that reads thousands of answers."""
T = TypeVar("T")

__all__ = ["FinalReceipt", "NetworkClient"]

_NO_WAIT_HELPS = BY_ITS_CLOCK | {"BLOCK_PRUNED", "CONTRACT_DISABLED", "CONTRACT_CALL_OUTDATED"}
"""What stays so for a transaction after every node has said it, or until organisations decide otherwise."""


class NetworkClient:
    """A client of one network; an async context manager.

    `urls` (name to address) fixes the nodes, else they come from genesis and proved state; `first` is tried first. `pinned`
    is a former client's. `troubles` holds unresolved failures by node.
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
        """Raises CONFIGURATION_INVALID for invalid addresses, unknown nodes, plain HTTP beyond loopback."""
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
        self.custody = CustodyClient(self._book, self.ask_node, self.state_values)

    async def __aenter__(self) -> NetworkClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        await self._connections.close()

    async def forget_key(self, public_key: bytes) -> None:
        self._sessions.forget_key(public_key)
        await self._connections.close_lane(public_key)

    @property
    def pinned(self) -> bytes:
        """For the next client; prevents rollback and keeps known nodes."""
        return write_pin(self.light_client, self._book.known)

    @property
    def nodes(self) -> tuple[NodeAddress, ...]:
        """The known nodes, which may change at run time."""
        return self._book.addresses

    @property
    def unlisted(self) -> tuple[NodeAddress, ...]:
        """Given nodes that are on no list which this client has read."""
        return self._book.unlisted

    # Who is there

    @property
    def known_custodians(self) -> tuple[KnownCustodian, ...]:
        return self._book.known_custodians

    async def use_given(self, given: Sequence[GivenNode]) -> list[BlockRobotError]:
        """Ask these nodes there, the first of them first; return why some are not used. What of them is checked: the
        certificate, by the node's name and its organisation's authority, and the genesis file.
        """
        found = await asyncio.gather(*(self._meet(node) for node in given), return_exceptions=True)
        refusals = []
        for answer in found:
            if isinstance(answer, NodeAddress):
                self._book.give(answer)
                self._first = self._first or answer.name
            elif isinstance(answer, BlockRobotError):
                refusals.append(answer)
            else:
                raise answer
        return refusals

    async def _meet(self, given: GivenNode) -> NodeAddress:
        """Raises NODE_ADDRESS_UNUSABLE, NODE_ADDRESS_WRONG, NODE_UNREACHABLE."""
        authority = self._book.authority_of(given.name)
        claim = Claim(given.name, "") if authority is not None else await read_claim(given)
        if given.name and claim.name != given.name:
            sentence = f"{given.place} says that it is {claim.name!r}, not {given.name!r}."
            raise BlockRobotError("NODE_ADDRESS_WRONG", sentence)
        authority = self._book.authority_of(claim.name) or next(
            (other.ca_certificate for other in self.genesis.organisations if other.name == claim.organisation), None
        )
        if authority is None:
            sentence = f"{given.place} is {claim.name!r} of {claim.organisation!r}, unknown in this network."
            raise BlockRobotError("NODE_ADDRESS_WRONG", sentence)
        node = NodeAddress(claim.name, given.url, authority, is_given=True)
        if not await self.is_of_this_chain(node):
            raise BlockRobotError("NODE_ADDRESS_WRONG", f"Who answers at {given.place} is no node of this chain.")
        return node

    async def is_of_this_chain(self, node: NodeAddress) -> bool:
        """By what it says of its genesis file, which proves nothing. Raises NODE_UNREACHABLE and other passing errors."""
        try:
            content = await self.ask_node(node, "GET", "/v1/genesis", timeout_ms=GIVEN_TIMEOUT_MS)
            return genesis_from_json(content).chain_id == self.genesis.chain_id
        except BlockRobotError as error:
            if error.entry.retryable and error.code != "INTERNAL":
                raise
            return False

    async def find_nodes(self, key: PrivateKey) -> None:
        """Refresh nodes when due; failure keeps known ones. Reads do so themselves, submit-only clients call this."""
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
        """Repeat while news come: removed nodes name their last peers."""
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
        lane: bytes = ANONYMOUS_LANE,
        body: bytes | None = None,
        media_type: str = "application/json",
        query: Mapping[str, str | int] | None = None,
        timeout_ms: int = REQUEST_TIMEOUT_MS,
    ) -> bytes:
        """In the lane of `key` if given; reopens an expired session once."""
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

    async def with_any_node(self, work: Callable[[NodeAddress], Awaitable[T]]) -> T:
        """Try nodes in turn; raises a refusal once more nodes than may be faulty agree, or `failure_of` all. Where this
        client's budgets are used up, it waits a few seconds before it gives up.
        """
        for _ in range(BUDGET_WAITS_MAX_COUNT):
            try:
                return await self._try_nodes(work)
            except BlockRobotError as error:
                if error.code != "RATE_LIMITED":
                    raise
            await asyncio.sleep(BUDGET_WAIT_MS / 1000)
        return await self._try_nodes(work)

    async def _try_nodes(self, work: Callable[[NodeAddress], Awaitable[T]]) -> T:
        failures: list[BlockRobotError] = []
        believed_count = 1 + Schedule.of(self.light_client.epoch).faults_tolerated
        for node in self._book.unlisted:
            try:
                return await self._through_epochs(node, work)
            except BlockRobotError as error:
                self._note_trouble(node, error)  # its word alone counts for nothing: it is not proved to be a node
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
        if error.code in {"NODE_UNREACHABLE", "NODE_ADDRESS_WRONG", *NOT_TAKING_PART}:
            self._book.note_failure()

    def _in_turn(self) -> tuple[NodeAddress, ...]:
        nodes = self._book.addresses
        start = next((index for index, node in enumerate(nodes) if node.name == self._first), 0)
        return (*nodes[start:], *nodes[:start])

    async def _through_epochs(self, node: NodeAddress, work: Callable[[NodeAddress], Awaitable[T]]) -> T:
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
        content = await self.ask_node(node, "GET", "/v1/epochs", query={"after": self._trust.epoch})
        return self._trust.follow(read_answer(content, EpochsAnswer))

    async def _ask_until_fresh(self, work: Callable[[NodeAddress], Awaitable[T]]) -> T:
        """As `with_any_node`, waiting for lagging nodes."""
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
        """Submit to one node. Raises a rejection once more nodes than may be faulty agree."""

        async def submit_to(node: NodeAddress) -> bytes:
            (error,) = await self._submit_to(node, [transaction])
            if error is not None:
                raise error
            return transaction.txid

        return await self.with_any_node(submit_to)

    async def submit_batch(self, transactions: Sequence[Transaction]) -> list[BlockRobotError | None]:
        """Submit up to 256 transactions to one node; return rejections or None. They share a lane, which links the
        senders.
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
        self, txid: bytes, timeout_ms: int = WAIT_DEFAULT_MS, *, lane: bytes = ANONYMOUS_LANE
    ) -> FinalReceipt:
        """Return the proved receipt. Raises TRANSACTION_NOT_FINAL_IN_TIME, TRANSACTION_EXPIRED."""
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
        """Raises TRANSACTION_EXPIRED."""
        content = await self.ask_node(
            node,
            "GET",
            f"/v1/transactions/{txid.hex()}",
            lane=lane,
            query={"wait_ms": wait_ms, "evidence": 1},
            timeout_ms=wait_ms + FROZEN_AFTER_MS,
        )
        answer = read_answer(content, TransactionState)
        if answer.status == "expired":
            raise BlockRobotError("TRANSACTION_EXPIRED", txid=txid.hex())
        if answer.status != "finalized" or answer.evidence is None or answer.index is None:
            return None
        return self._trust.receipt(answer.evidence, txid, answer.index)

    async def submit_and_wait(self, transaction: Transaction, timeout_ms: int = WAIT_DEFAULT_MS) -> FinalReceipt:
        """Submit, resubmitting while not final; idempotent. Raises rejections, TRANSACTION_EXPIRED,
        TRANSACTION_NOT_FINAL_IN_TIME (may still become final).
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
            self._book.unlisted = ()
            self._first = self._in_turn()[1 % len(self.nodes)].name

    async def _final_after_rejection(self, transaction: Transaction, error: BlockRobotError) -> FinalReceipt:
        """Look the transaction up first: it may have been final before it expired."""
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
        """Sign, submit and wait. Raises CALL_REFUSED and others."""
        transaction = self.transactions.build(key, contract, entry, arguments)
        return replace((await self.submit_and_wait(transaction, timeout_ms)).require_ok(), transaction=transaction)

    # Reading

    async def newest_header(self, key: PrivateKey) -> Header:
        """Provably final. Raises PROOF_STALE if all lag."""

        async def ask(node: NodeAddress) -> Header:
            answer = read_answer(await self.ask_node(node, "GET", "/v1/finality", key=key), FinalityAnswer)
            return self._trust.finality(answer.finality)

        await self.find_nodes(key)
        return await self._ask_until_fresh(ask)

    async def catch_up(self, key: PrivateKey) -> Header:
        """Pin the newest header of any node, then prefer that node. Raises NODE_UNREACHABLE etc."""

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
        """Proved by this node, and pinned. Raises PROOF_STALE."""
        content = await self.ask_node(node, "GET", "/v1/finality", key=key, timeout_ms=CATCH_UP_TIMEOUT_MS)
        return self._trust.finality(read_answer(content, FinalityAnswer).finality)

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        """Up to 128, proved by one state. Raises VALUE_INVALID, PROOF_INVALID, PROOF_STALE."""
        if not 1 <= len(keys) <= PROOF_KEYS_MAX_COUNT:
            raise BlockRobotError("VALUE_INVALID", f"One proof is for 1 to {PROOF_KEYS_MAX_COUNT} keys.")
        await self.find_nodes(key)
        return await self._read_values(keys, key)

    async def _read_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        body = msgspec.json.encode(ProofsRequest([flat.hex() for flat in keys]))

        async def ask(node: NodeAddress) -> ProvedState:
            content = await self.ask_node(node, "POST", "/v1/state-proofs", key=key, body=body)
            return self._trust.values(read_answer(content, ProofsAnswer), keys)

        return await self._ask_until_fresh(ask)

    async def prove_public(
        self, asking: Callable[[NodeAddress], Awaitable[bytes]], keys: Sequence[bytes]
    ) -> ProvedState:
        """Without a session. Raises PROOF_*."""

        async def ask(node: NodeAddress) -> ProvedState:
            return self._trust.values(read_answer(await asking(node), ProofsAnswer), keys)

        return await self._ask_until_fresh(ask)

    async def state_value(self, flat: bytes, key: PrivateKey) -> Any:
        """Return the proved value, None if it is absent."""
        return (await self.state_values([flat], key)).values[flat]

    async def query(self, contract: str, view: str, arguments: list[Any], key: PrivateKey) -> Any:
        """From one node, unproved. Raises CALL_REFUSED etc."""
        body = msgspec.json.encode(QueryRequest(contract, view, encode_value(arguments).hex()))
        content = await self.with_any_node(lambda node: self.ask_node(node, "POST", "/v1/queries", key=key, body=body))
        return decode_value(read_hex(read_answer(content, QueryAnswer).result))

    async def announcements(
        self, first: int, key: PrivateKey, limit: int = ANNOUNCEMENTS_PAGE_MAX_COUNT
    ) -> AnnouncementPage:
        """From `first` (`limit` up to 200), proved complete."""
        if first < 0 or not 1 <= limit <= ANNOUNCEMENTS_PAGE_MAX_COUNT:
            raise BlockRobotError("VALUE_INVALID", f"A page has 1 to {ANNOUNCEMENTS_PAGE_MAX_COUNT} announcements.")

        async def ask(node: NodeAddress) -> AnnouncementPage:
            query = {"from": first, "limit": limit}
            content = await self.ask_node(node, "GET", "/v1/announcements", key=key, query=query)
            return read_announcements(self._trust, read_answer(content, ProofsAnswer), first, limit)

        await self.find_nodes(key)
        return await self._ask_until_fresh(ask)


@contextlib.asynccontextmanager
async def open_pinned_client(genesis: Genesis, path: Path) -> AsyncIterator[NetworkClient]:
    """Open a client from the pin in a file and save its new pin there. Raises FILE_UNUSABLE if damaged."""
    pinned = read_pin(path)
    try:
        client = NetworkClient(genesis, pinned=pinned)
    except BlockRobotError as error:
        if pinned is None:
            raise
        sentence = f"{path} is damaged, or of another network ({error.code}): remove it, and the client begins anew."
        raise BlockRobotError("FILE_UNUSABLE", sentence) from None
    async with client:
        await use_given_nodes(client, genesis.chain_id)
        try:
            yield client
        finally:
            if client.pinned != pinned:
                replace_file(path, client.pinned)
