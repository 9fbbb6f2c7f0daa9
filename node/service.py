"""One node, put together: what is made, in which order it starts, and how it stops. Must never decide anything itself."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Mapping
from contextlib import AsyncExitStack
from importlib.metadata import version
from types import TracebackType
from typing import Any, Self

import structlog
from aiohttp import web

from consensus.block import Block, FinalityProof, Header, QuorumCertificate, genesis_certificate
from consensus.core import Core
from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.primitives.encoding import decode
from consensus.transaction import Transaction
from contracts.execution.machine import ContractMachine
from contracts.execution.registry import require_contracts
from contracts.execution.standing import require_standing
from node.api import ApiServices, create_api
from node.api.server import serve_api
from node.config import NodeConfig, load_genesis, load_key
from node.custody import Custody
from node.engine import Engine
from node.execution import ExecutedBlock, Executor
from node.finality import FinalityFeed, LedgerWriter
from node.interface import FinalizedLedger, Pool, WallClock
from node.journal import Journal
from node.journal_age import require_newest_journal
from node.machine import ViewRunner, genesis_block
from node.mempool import Mempool
from node.metrics import NodeMetrics
from node.offchain.custodian import Custodian
from node.offchain.erase_keys import EraseKeys
from node.offchain.open_store import open_store
from node.operator import create_operator_listener
from node.p2p.network import PeerNetwork, bind_listener
from node.peers import Peers
from node.storage.ledger_store import Position
from node.storage.lmdb_store import DATA_FILE_NAME, LmdbStore
from node.sync import Synchroniser
from node.transaction_cache import TransactionCache

HOUSEKEEPING_INTERVAL_MS = 1_000
API_BODY_MAX_BYTES = 32 * 1024 * 1024
HTTP_STOP_MS = 500

log = structlog.get_logger(__name__)


async def open_ledger(config: NodeConfig, genesis: Genesis) -> LmdbStore:
    """Open the ledger; make it with the genesis block if this is the node's first start.

    Raises DATA_DIRECTORY_IN_USE, DATA_DIRECTORY_INVALID, STORAGE_*, GENESIS_INVALID.
    """
    if not (config.ledger_dir / DATA_FILE_NAME).exists():
        ledger = LmdbStore.create(config.ledger_dir)
    else:
        ledger = LmdbStore.open(config.ledger_dir)
    try:
        if ledger.position is None:
            await ledger.commit([genesis_block(genesis)], b"")
        with ledger.snapshot() as snapshot:
            if snapshot.block_height(genesis.block_id) != 0:
                raise BlockRobotError("DATA_DIRECTORY_INVALID", "The ledger is that of another genesis file.")
    except BaseException:
        await ledger.close()
        raise
    return ledger


def read_head(ledger: LmdbStore, genesis: Genesis) -> tuple[Block, QuorumCertificate]:
    """Return the newest stored block and the certificate for it."""
    with ledger.snapshot() as snapshot:
        position = snapshot.position
        data = None if position is None else snapshot.block(position.height)
        if position is None or data is None:
            raise BlockRobotError("STORAGE_DAMAGED", "The ledger does not hold its newest block.")
        if position.height == 0:
            return decode(data, Block), genesis_certificate(genesis.block_id)
        proof = decode(snapshot.finality, FinalityProof)
    return decode(data, Block), decode(proof.child_header_bytes, Header).qc


class Node:
    """A running node, as an async context manager: entered when it serves, left when all is closed."""

    def __init__(self, config: NodeConfig) -> None:
        """Read genesis and keys. Raises CONFIGURATION_INVALID or GENESIS_INVALID."""
        self.config = config
        self.genesis = load_genesis(config)
        self._entry = self.genesis.node(config.name)
        self._clock = WallClock()
        self._stack = AsyncExitStack()
        self._started_at = time.monotonic()
        path = config.producer_key_path
        self._key = None if path is None else load_key(path, self._entry.producer_key, "producer")

    async def __aenter__(self) -> Self:
        """Open, connect, serve. Raises DATA_DIRECTORY_IN_USE, PORT_IN_USE, JOURNAL_*, STORAGE_*."""
        try:
            await self._open()
            await self._start()
        except BaseException:
            await self._stack.aclose()
            raise
        gc.collect()
        gc.freeze()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop in the reverse order."""
        await self._stack.aclose()
        log.info("node_stopped", height=self._feed.height)

    async def _open(self) -> None:
        """Make all parts; nothing is said to anybody yet."""
        config, genesis, stack, now_ms = self.config, self.genesis, self._stack, self._clock.now_ms
        self._ledger = ledger = await open_ledger(config, genesis)
        stack.push_async_callback(ledger.close)
        journal = Journal.open(config.journal_path)
        stack.callback(journal.close)
        head, head_qc = read_head(ledger, genesis)
        self.core = Core(
            genesis.settings,
            genesis.chain_id,
            genesis.schedule,
            self._key,
            finalized=head,
            finalized_qc=head_qc,
            round_zero_id=genesis.block_id,
            journal=[entry.record for entry in journal.entries],
        )
        with ledger.snapshot() as snapshot:
            if snapshot.finality:
                proof = decode(snapshot.finality, FinalityProof)
                require_newest_journal(proof, self.core.index, self.core.last_voted_round)
        machine = ContractMachine(genesis.chain_id, require_contracts(genesis))
        cache = TransactionCache()
        self._executor = Executor(genesis=genesis, ledger=ledger, machine=machine, cache=cache, key=self._key)
        stack.callback(self._executor.close)
        self._mempool = Mempool(
            chain_id=genesis.chain_id, cache=cache, has_standing=self._has_standing, is_spent=self._is_spent
        )
        self._feed = FinalityFeed(head.header.height)
        self._writer = LedgerWriter(ledger)
        self._engine = Engine(
            core=self.core,
            executor=self._executor,
            mempool=self._mempool,
            journal=journal,
            sink=self._writer,
            clock=now_ms,
        )
        self._peers = Peers(genesis=genesis, name=config.name, mempool=self._mempool, ledger=ledger, clock=now_ms)
        self._network = PeerNetwork(config, genesis, self._peers)
        self._sync = Synchroniser(
            genesis=genesis,
            ledger=ledger,
            engine=self._engine,
            executor=self._executor,
            writer=self._writer,
            feed=self._feed,
            requester=self._network,
        )
        self._peers.connect(self._network, self._engine, self._sync)
        self._pool = Pool(
            mempool=self._mempool, engine=self._engine, gossip=self._peers.gossip, feed=self._feed, clock=self._clock
        )
        self._metrics = NodeMetrics(self._gauges(), now_ms)
        self._custody = await self._open_custody()

    async def _open_custody(self) -> Custody | None:
        """Open the custodian's store and erase keys, if this node is a custodian.

        Raises STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED, CONFIGURATION_INVALID.
        """
        config, clock_ms = self.config, self._clock.now_ms
        path = config.custodian_key_path
        if path is None:
            return None
        key = load_key(path, self._entry.custodian_key, "custodian")
        store = open_store(config.custody_store, config.custody_dir)
        erase_keys = self._stack.enter_context(EraseKeys(config.erase_keys_dir))
        await self._stack.enter_async_context(store)
        custody = Custody(
            genesis=self.genesis,
            name=config.name,
            custodian=Custodian(store, erase_keys, member=key.public_key, clock_ms=clock_ms),
            key=key,
            ledger=self._ledger,
            feed=self._feed,
            pool=self._pool,
            peers=self._network,
            clock=clock_ms,
        )
        self._peers.clips = custody
        return custody

    async def _start(self) -> None:
        """Bind the ports, then begin to take part, then let clients in."""
        config, stack = self.config, self._stack
        api_socket = bind_listener(config.host, config.api_port)
        stack.callback(api_socket.close)
        operator_socket = bind_listener(config.host, config.operator_port)
        stack.callback(operator_socket.close)
        self._writer.add_listener(self._engine.note_stored)
        self._writer.add_listener(self._feed.publish)
        self._writer.add_listener(self._metrics.note_finalized)
        self._writer.add_listener(self._after_stored)
        self._writer.start(on_failure=self._engine.fail, between_events=self._engine.call_between_events)
        stack.push_async_callback(self._writer.stop)
        stack.push_async_callback(self._engine.stop)
        stack.push_async_callback(self._sync.stop)
        stack.push_async_callback(self._peers.stop)
        await self._network.start()
        stack.push_async_callback(self._network.stop)
        self._engine.start(self._peers)
        housekeeping = asyncio.get_running_loop().create_task(self._keep_house(), name="housekeeping")
        stack.push_async_callback(_cancel, housekeeping)
        if self._custody is not None:
            await self._custody.start()
            stack.push_async_callback(self._custody.stop)
        services = ApiServices(
            genesis=self.genesis,
            node_name=config.name,
            clock=self._clock,
            ledger=FinalizedLedger(self._ledger, self._feed),
            views=ViewRunner(self.genesis),
            pool=self._pool,
            custody=self._custody,
        )
        await stack.enter_async_context(serve_api(create_api(services), api_socket, HTTP_STOP_MS))
        await self._serve(create_operator_listener(self), operator_socket)
        log.info("node_started", name=config.name, height=self._feed.height)

    async def _serve(self, application: web.Application, listener: Any) -> None:
        runner = web.AppRunner(application, access_log=None, shutdown_timeout=HTTP_STOP_MS / 1000)
        await runner.setup()
        self._stack.push_async_callback(runner.cleanup)
        await web.SockSite(runner, listener).start()

    # What the parts ask of the whole

    def _has_standing(self, transaction: Transaction) -> bool:
        reader = self._executor.reader
        position = reader.position
        if position is None:
            return False
        require_standing(reader, transaction, position.timestamp_ms)
        return True

    def _is_spent(self, txid: bytes) -> bool:
        return self._engine.is_on_branch(txid) or self._executor.reader.locate(txid) is not None

    def _after_stored(self, _blocks: list[ExecutedBlock], _proof: FinalityProof, _position: Position) -> None:
        self._peers.retry_unsettled()

    async def _keep_house(self) -> None:
        """Once a second: drop what expired, tell peers the height, look again whether there is work."""
        announced = -1
        while True:
            await asyncio.sleep(HOUSEKEEPING_INTERVAL_MS / 1000)
            self._pool.purge_expired()
            self._peers.retry_unsettled()
            self._engine.note_work()
            if self._feed.height != announced:
                announced = self._feed.height
                self._peers.announce_height(announced)

    # NodeStatus

    def is_ready(self) -> bool:
        """Tell whether the node is in touch with a quorum, is not far behind, and can write."""
        in_touch = 1 + len(self._network.connected)
        return in_touch >= self.genesis.schedule.quorum and self._engine.is_signing and not self._sync.is_running

    def describe(self) -> Mapping[str, Any]:
        """Return how the node is doing, ready for JSON."""
        core = self.core
        position = self._executor.reader.position
        return {
            "name": self.config.name,
            "organisation": self._entry.organisation,
            "chain_id": self.genesis.chain_id.hex(),
            "ready": self.is_ready(),
            "height": core.finalized.height + len(core.certified_branch()),
            "finalized_height": self._feed.height,
            "state_root": position.state_root.hex() if position else None,
            "round": core.round,
            "epoch": core.epoch,
            "leader": self._leader_name(),
            "peers": self._network.connected,
            "mempool": len(self._mempool),
            "custody_checkpoint": None if self._custody is None else self._custody.checkpoint_height,
            "fault": core.halted or self._engine.fault,
            "version": version("blockrobot"),
            "uptime_s": round(time.monotonic() - self._started_at, 1),
        }

    def _leader_name(self) -> str:
        key = self.genesis.schedule.producers[self.core.leader]
        return next(node.name for node in self.genesis.nodes if node.producer_key == key)

    def metrics(self) -> bytes:
        """Return the metrics in the Prometheus text format."""
        return self._metrics.render()

    def _gauges(self) -> dict[str, tuple[str, Any]]:
        return {
            "blockrobot_finalized_height": ("Height of the newest stored block.", lambda: self._feed.height),
            "blockrobot_round": ("The round that the node is in.", lambda: self.core.round),
            "blockrobot_peers_connected": ("Connected peers.", lambda: len(self._network.connected)),
            "blockrobot_mempool_transactions": ("Waiting transactions.", lambda: len(self._mempool)),
            "blockrobot_mempool_size_bytes": ("Bytes of waiting transactions.", lambda: self._mempool.size_bytes),
            "blockrobot_rounds_timed_out": (
                "Rounds that this node gave up since its start.",
                lambda: self._engine.rounds_timed_out_count,
            ),
            "blockrobot_signing": ("1 while the node takes part.", lambda: float(self._engine.is_signing)),
        }


async def _cancel(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
