"""One node's files, sockets and HTTP around the parts of `node/components.py`."""

from __future__ import annotations

import asyncio
import gc
import shutil
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import structlog

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from node.api import ApiServices, create_api
from node.api.access.trusted_proxies import TrustedProxies
from node.api.server import serve_api
from node.api_adapters import EngineRounds, WallClock
from node.components import Environment, NodeComponents, begin_ledger
from node.config import OPERATOR_HOST, READING_TOKEN_FILE_NAME, NodeConfig, load_genesis, load_key
from node.consensus.engine import Outbox
from node.consensus.journal import open_journal
from node.consensus.journal_disk import SystemDisk
from node.consensus.round_log import LoggingOutbox, RoundLog
from node.custody.coordination.consent_receipts import ConsentReceipts
from node.custody.coordination.custody_coordinator import CustodyPlace
from node.custody.erase_keys import EraseKeys
from node.custody.moving import require_no_move
from node.custody.stores.open_store import open_store
from node.directory.directory_file import newest_beginning
from node.directory.node_directory import Directory
from node.execution.sandboxed_contracts import open_contracts
from node.faults import FaultSwitch, FillableDisk, read_or_make_token
from node.limits.disk_reserve import DiskReserve
from node.mempool.transaction_intake import ClientPool
from node.metrics import Figures, ProcessMetrics
from node.operator_listener import create_metrics_listener, create_operator_listener, serve_metrics, serve_operator
from node.p2p.connection_acceptor import OF_CLIENTS, ConnectionAcceptor, bind_listener
from node.p2p.network import PeerHandler, PeerNetwork
from node.retention.pruning import answer_requests
from node.snapshot.joining import SnapshotJoiner
from node.snapshot.snapshot_store import SnapshotStore
from node.storage.lmdb_store import DATA_FILE_NAME, LmdbStore
from pages.listening import Accept, accept_plain, is_loopback

HTTP_STOP_MS = 500
JOIN_INTERVAL_S = 1.0

log = structlog.get_logger(__name__)


async def open_ledger(config: NodeConfig, genesis: Genesis) -> LmdbStore:
    """Open the ledger, created with genesis if missing.

    Raises DATA_DIRECTORY_IN_USE, DATA_DIRECTORY_INVALID, STORAGE_*, GENESIS_INVALID, GENESIS_IN_USE.
    """
    if not (config.ledger_dir / DATA_FILE_NAME).exists():
        ledger = LmdbStore.create(config.ledger_dir)
    else:
        ledger = LmdbStore.open(config.ledger_dir)
    try:
        await begin_ledger(ledger, genesis)
    except BaseException:
        await ledger.close()
        raise
    return ledger


class Node:
    """A running node: entered when it serves, left when all is closed."""

    def __init__(
        self,
        config: NodeConfig,
        *,
        clock: WallClock | None = None,
        wrap_outbox: Callable[[Outbox, NodeComponents], Outbox] | None = None,
        restored: bool = False,
    ) -> None:
        """`restored`: the data is from a backup, or its journal is lost.

        Raises CONFIGURATION_INVALID, GENESIS_INVALID, FAULT_INVALID, FILE_UNUSABLE.
        """
        self.config = config
        self.genesis = load_genesis(config)
        self._clock = clock or WallClock()
        self._wrap_outbox = wrap_outbox
        self._restored = restored
        self._faults: FaultSwitch | None = None
        self._token = ""
        self._custodian_key: PrivateKey | None = None
        self._spoken = RoundLog(self._clock.now_ms, self._leader_name)
        if config.faults_enabled:
            self._faults = FaultSwitch(config.name, config.data_dir, self._clock)
        if config.faults_enabled or config.custodian_key_path is not None:
            self._token = read_or_make_token(config.data_dir)
        self._process_metrics = ProcessMetrics(self._process_figures())
        self._stack = AsyncExitStack()
        self._acceptor: ConnectionAcceptor | None = None
        self.begin_anew = asyncio.Event()
        """Set once a restored ledger lies ready: the node has to be closed and opened again."""

    async def __aenter__(self) -> Self:
        """Raises DATA_DIRECTORY_IN_USE, PORT_*, ADDRESS_NOT_HERE, JOURNAL_*, STORAGE_*."""
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
        await self._stack.aclose()
        log.info("node_stopped", height=self._parts.feed.height)

    async def _open(self) -> None:
        config, genesis, stack, faults = self.config, self.genesis, self._stack, self._faults
        ledger = await open_ledger(config, genesis)
        stack.push_async_callback(ledger.close)
        if faults is not None:
            ledger.require_space = partial(faults.require_space, "ledger")
        disk = None if faults is None else FillableDisk(SystemDisk(), faults, "journal")
        if self._restored:
            config.journal_dir.mkdir(parents=True, exist_ok=True)  # a backup may have come back without it
        journal = open_journal(config.journal_path, restored=self._restored, disk=disk)
        stack.callback(journal.close)
        self._contracts = await open_contracts(config, genesis, ledger)
        stack.push_async_callback(self._contracts.close)
        directory = Directory(newest_beginning(config.data_dir, genesis))
        with ledger.snapshot() as snapshot:
            directory.refresh(snapshot, 0 if snapshot.position is None else snapshot.position.height)
        self._parts = NodeComponents(
            Environment(
                genesis=genesis,
                name=config.name,
                ledger=ledger,
                journal=journal,
                clock=self._clock,
                open_network=partial(self._open_network, directory),
                key=self._own_key(directory, config.producer_key_path, "producer"),
                directory=directory,
                custody=await self._open_custody(directory),
                keep_blocks=0 if config.archive else config.keep_blocks,
                wrap_outbox=self._around_outbox,
                machine=self._contracts.machine,
                waits_for_machine=self._contracts.machine is not None,
            )
        )
        stack.push_async_callback(self._parts.stop)
        await self._open_snapshots(ledger)

    async def _open_snapshots(self, ledger: LmdbStore) -> None:
        config, parts = self.config, self._parts
        shelf = SnapshotStore(ledger, config.snapshots_dir)
        await shelf.open()
        self._stack.push_async_callback(shelf.stop)
        parts.peers.snapshots = shelf
        parts.writer.set_milestones(config.keep_blocks // 2, shelf.begin)
        parts.pruner.add_listener(shelf.note_pruned)
        self._snapshot_joiner = SnapshotJoiner(
            genesis=self.genesis,
            requester=self._network,
            gap=parts.sync,
            ledger_dir=config.ledger_dir,
            folder=config.fetched_dir,
            lag_max=config.snapshot_lag_blocks,
            restart=self.begin_anew.set,
        )
        self._stack.push_async_callback(self._snapshot_joiner.stop)

    async def _join_when_behind(self) -> None:
        while True:
            await asyncio.sleep(JOIN_INTERVAL_S)
            self._snapshot_joiner.start_if_behind()
            await answer_requests(self.config.data_dir, self._parts.pruner)

    def _open_network(self, directory: Directory, handler: PeerHandler) -> PeerNetwork:
        shaper = None if self._faults is None else self._faults.shaper
        now_ms = self._clock.now_ms
        self._network = PeerNetwork(self.config, self.genesis, handler, shaper, directory=directory, clock=now_ms)
        return self._network

    def reload_certificate(self) -> None:
        self._network.reload_certificate()

    # NodeStatus: how the parts are, and how the links are

    def is_ready(self) -> bool:
        return self._parts.is_ready() and self._network.own_problem() is None

    def problem(self) -> BlockRobotError | None:
        return self._network.own_problem()

    def describe(self) -> Mapping[str, Any]:
        links = self._network.describe()
        own = {"ready": self.is_ready(), "now_ms": self._clock.now_ms(), "contracts": self._contracts.describe()}
        kept = {"blocks_kept": self._parts.pruner.describe()}
        return {**self._parts.describe(), **links, **own, **kept, **self._seats(), "rounds": self._spoken.describe()}

    def metrics(self) -> bytes:
        return self._parts.metrics() + self._process_metrics.render() + self._network.traffic.render()

    def _process_figures(self) -> Figures:
        return {
            "blockrobot_certificate_ends_timestamp_seconds": (
                "When the node's certificate ends, in Unix time.",
                lambda: self._network.certificate_not_after_ms / 1000,
            ),
            "blockrobot_disk_free_bytes": (
                "Free space of the data directory's disk.",
                lambda: shutil.disk_usage(self.config.data_dir).free,
            ),
            "blockrobot_disk_size_bytes": (
                "Size of that disk.",
                lambda: shutil.disk_usage(self.config.data_dir).total,
            ),
        }

    def _around_outbox(self, outbox: Outbox) -> Outbox:
        noting = LoggingOutbox(outbox, self._spoken)
        return noting if self._wrap_outbox is None else self._wrap_outbox(noting, self._parts)

    def _seats(self) -> dict[str, Any]:
        schedule, name_of = self._parts.engine.epoch.schedule, self._parts.directory.name_of_producer
        return {"quorum": schedule.quorum, "producers": [name for key in schedule.producers if (name := name_of(key))]}

    def _leader_name(self, epoch: int, round_number: int) -> str | None:
        schedule = self._parts.engine.epoch.schedule
        if schedule.epoch != epoch:
            return None
        return self._parts.directory.name_of_producer(schedule.producers[schedule.leader(round_number)])

    def _own_key(self, directory: Directory, path: Path | None, role: str) -> PrivateKey | None:
        """Raises CONFIGURATION_INVALID for a foreign key; with a chain it is only logged."""
        if path is None:
            return None
        node = directory.content.nodes.get(self.config.name)
        agreed = None if node is None else node.producer_key if role == "producer" else node.custodian_key
        key = load_key(path, agreed if directory.height == 0 else None, role)
        if agreed is not None and key.public_key != agreed:
            log.warning("key_not_agreed", role=role, height=directory.height)
        return key

    async def _open_custody(self, directory: Directory) -> CustodyPlace | None:
        """Raises STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED, CONFIGURATION_INVALID."""
        config = self.config
        key = self._own_key(directory, config.custodian_key_path, "custodian")
        if key is None:
            return None
        self._custodian_key = key
        require_no_move(config.data_dir)
        store = open_store(config.custody_store, config.custody_dir, self._require_custody_space, config.clips)
        erase_keys = self._stack.enter_context(EraseKeys(config.erase_keys_dir))
        await self._stack.enter_async_context(store)
        reserve = DiskReserve(config.data_dir, config.custody_reserve_mib, config.clips_dir)
        return CustodyPlace(key, store, erase_keys, reserve, config.custody_room_gib)

    def _require_custody_space(self) -> None:
        if self._faults is not None:
            self._faults.require_space("custody")

    def _accept(self, *, tls: bool) -> Accept:
        """All listeners for clients share the places for handshakes."""
        if not tls:
            return accept_plain
        if self._acceptor is None:
            self._acceptor = ConnectionAcceptor(
                self._network.client_context, self._parts.peers.on_over_budget, OF_CLIENTS
            )
            self._stack.callback(self._acceptor.close)
        return self._acceptor.accept

    async def _start(self) -> None:
        config, stack, parts = self.config, self._stack, self._parts
        api_socket = bind_listener(config.api_host, config.api_port)
        stack.callback(api_socket.close)
        operator_socket = bind_listener(OPERATOR_HOST, config.operator_port)
        stack.callback(operator_socket.close)
        metrics_socket = bind_listener(config.metrics_host, config.metrics_port) if config.metrics_host else None
        if metrics_socket is not None:
            stack.callback(metrics_socket.close)
        await parts.start()
        rounds = EngineRounds(parts.engine, self._clock)
        parts.writer.add_listener(rounds.note_final)
        looking = asyncio.get_running_loop().create_task(self._join_when_behind(), name="joining")
        stack.callback(looking.cancel)
        services = ApiServices(
            genesis=self.genesis,
            node_name=config.name,
            clock=self._clock,
            ledger=parts.finalized,
            views=self._contracts.views,
            pool=ClientPool(parts.pool, self.problem),
            custody=parts.custody,
            receipts=None
            if self._custodian_key is None
            else ConsentReceipts(self._custodian_key, parts.sync.peers_with_block),
            rounds=rounds,
            public_explorer=config.public_explorer,
            trusted_proxies=TrustedProxies(config.trusted_proxies),
            on_over_budget=parts.on_over_budget,
            peers_with_block=parts.sync.peers_with_block,
        )
        await stack.enter_async_context(
            serve_api(create_api(services), api_socket, HTTP_STOP_MS, self._accept(tls=config.api_tls))
        )
        reading = read_or_make_token(config.data_dir, READING_TOKEN_FILE_NAME)
        operator = create_operator_listener(self, self._faults, self._token, parts.custody_admin, reading_token=reading)
        await stack.enter_async_context(serve_operator(operator, operator_socket, HTTP_STOP_MS))
        if metrics_socket is not None:
            figures = create_metrics_listener(self, parts.custody_admin, reading_token=reading)
            accept = self._accept(tls=not is_loopback(config.metrics_host))
            await stack.enter_async_context(serve_metrics(figures, metrics_socket, HTTP_STOP_MS, accept))
        log.info("node_started", name=config.name, height=parts.feed.height)
