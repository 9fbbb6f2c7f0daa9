"""The hospital's chain: real contracts and ledger, one producer, and blocks at the times that the program names."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from msgspec import structs

from consensus.chain.block import Block, Receipt, Receipts
from consensus.chain.transaction import Transaction, decode_transaction, sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.keys import PrivateKey
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.genesis import complete_genesis
from network.bench.growth.growth_ledgers import BlockMaker, open_chain
from network.provisioning.certificate_authority import create_authority, issue_node_certificate, write_secret
from network.provisioning.founding import adopt_genesis
from network.sim.workload import make_material
from network.sim.world.sim_chain import Chain, make_key, make_node_entry, node_name
from node.config import CONFIG_FILE, LOOPBACK, NodeConfig, config_to_toml
from node.custody.finalized_events import FinalizedEvents, collect_events
from node.execution.block_executor import genesis_block
from node.storage.ledger_store import LedgerSnapshot
from node.storage.lmdb_store import LmdbStore

CALL_VALID_MS = 5 * 60_000
BLOCK_CALLS_MAX_COUNT = 64
_FIRST_PORT, _PORTS_A_NODE = 7_272, 10


def make_hospital_chain(custodians: int) -> Chain:
    """One organisation; the first node makes the blocks, and each is a custodian."""
    chain = open_chain()
    keys = tuple(make_key(f"custodian {index}") for index in range(custodians))
    nodes = [make_node_entry(index, chain.producers[0], key) for index, key in enumerate(keys)]
    organisation = chain.genesis.organisations[0].name
    entries = tuple(
        structs.replace(
            entry,
            organisation=organisation,
            **({"producer_key": b"", "producer_possession": b""} if index else {}),
        )
        for index, entry in enumerate(nodes)
    )
    genesis = complete_genesis(structs.replace(chain.genesis, network="year", nodes=entries, state_root=b""))
    machine = ContractMachine.of_genesis(genesis)
    return replace(chain, genesis=genesis, first_block=genesis_block(genesis), custodians=keys, machine=machine)


def found_network(folder: Path, chain: Chain) -> list[NodeConfig]:
    """The folder of a network as commands find it; the first node's ledger is that of all."""
    configs, authority = [], create_authority("hospital")
    for index, key in enumerate(chain.custodians):
        place = folder / "nodes" / node_name(index)
        producer, port = place / "keys" / "producer.key", _FIRST_PORT + _PORTS_A_NODE * index
        config = NodeConfig(
            data_dir=place,
            name=node_name(index),
            genesis_path=place / "genesis.json",
            host=LOOPBACK,
            p2p_port=port,
            api_port=port + 1,
            operator_port=port + 2,
            tls_certificate_path=place / "keys" / "tls.crt.pem",
            tls_key_path=place / "keys" / "tls.key.pem",
            producer_key_path=None if index else producer,
            custodian_key_path=place / "keys" / "custodian.key",
            custody_store="sqlite",
            log_level="info",
            archive=True,
        )
        assert key is not None, "each node of the hospital is a custodian"
        write_secret(place / "keys" / "custodian.key", key.secret)
        issued = issue_node_certificate(authority, config.name)
        write_secret(config.tls_certificate_path, issued.certificate_pem)
        write_secret(config.tls_key_path, issued.key_pem)
        if not index:
            write_secret(producer, chain.producers[0].secret)
        write_secret(place / CONFIG_FILE, config_to_toml(config).encode())
        configs.append(config)
    adopt_genesis(chain.genesis, folder, [config.data_dir for config in configs])
    return configs


@dataclass(slots=True)
class Spent:
    """Seconds by what they went into."""

    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))

    @contextmanager
    def on(self, what: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.seconds[what] += time.perf_counter() - started


@dataclass(frozen=True, slots=True)
class MadeBlock:
    """A block that is stored: what came of its calls, and what custodians hear of it."""

    receipts: dict[bytes, Receipt]
    events: FinalizedEvents


class HospitalChain:
    """Signs calls, and makes, executes and stores blocks. `at_ms` is the time of the next one, if it can be."""

    def __init__(self, chain: Chain, ledger_dir: Path, seed: int, spent: Spent) -> None:
        self.chain, self.genesis = chain, chain.genesis
        self.chain_id = chain.genesis.chain_id
        self._ledger_dir, self._seed, self._spent = ledger_dir, seed, spent
        self._signed_count = 0
        self.transactions_count = self.blocks_count = 0
        self.store: LmdbStore
        self.maker: BlockMaker

    async def create(self) -> None:
        self.store = LmdbStore.create(self._ledger_dir)
        await self.store.commit([self.chain.first_block], b"")
        self.maker = BlockMaker.behind(self.chain, self.store)

    def open(self) -> None:
        """Again, after `close`."""
        self.store = LmdbStore.open(self._ledger_dir)
        at_ms, self.maker = self.maker.at_ms, BlockMaker.behind(self.chain, self.store)
        self.maker.at_ms = at_ms

    async def close(self) -> None:
        await self.store.close()

    @property
    def height(self) -> int:
        return self.maker.parent.height

    @property
    def now_ms(self) -> int:
        """The time of the block that comes next."""
        return self.maker.next_ms

    def sign(self, key: PrivateKey, contract: str, entry: str, *arguments: Any) -> Transaction:
        self._signed_count += 1
        signed = sign_transaction(
            key,
            chain_id=self.chain_id,
            contract=contract,
            entry=entry,
            arguments=list(arguments),
            valid_until_ms=self.now_ms + CALL_VALID_MS,
            salt=make_material(8, self._seed, "salt", self._signed_count),
        )
        return decode_transaction(signed.wire)

    async def block(self, calls: Sequence[Transaction]) -> MadeBlock:
        """With as many of the calls as fit, in order."""
        height, time_ms = self.height + 1, self.now_ms
        with self.store.snapshot() as parent, self._spent.on("execution"):
            result, _ = self.chain.machine.build(parent, height, time_ms, calls[:BLOCK_CALLS_MAX_COUNT])
        receipts = {receipt.txid: receipt for receipt in result.receipts}
        included = [call for call in calls if call.txid in receipts]
        block = self.maker.of_result(result, included)
        finality = self.maker.finality()
        with self._spent.on("commit"):
            await self.store.commit([block], finality)
        self.blocks_count += 1
        self.transactions_count += len(included)
        events = collect_events(height, block.block_id, time_ms, result.receipts)
        return MadeBlock(receipts, events)


def read_block(ledger: LedgerSnapshot, height: int) -> tuple[Block, Sequence[Receipt]]:
    """Raises BLOCK_PRUNED."""
    block, receipts = ledger.block(height), ledger.receipts(height)
    if block is None or receipts is None:
        raise BlockRobotError("BLOCK_PRUNED", f"The ledger does not hold block {height}.")
    return decode(block, Block), decode(receipts, Receipts).receipts


async def follow_blocks(chain: Chain, source: LmdbStore, target: LmdbStore) -> int:
    """Execute and store what another ledger has beyond this one, as a node that catches up; return how many blocks.

    Raises BLOCK_INVALID if a block comes out as another one here.
    """
    count = 0
    with source.snapshot() as newer:
        position = newer.position
        assert position is not None, "the ledger that is followed has blocks"
        maker = BlockMaker.behind(chain, target)
        for height in range(maker.parent.height + 1, position.height + 1):
            block, _ = read_block(newer, height)
            calls = [decode_transaction(wire) for wire in block.transactions]
            maker.at_ms = block.header.timestamp_ms
            with target.snapshot() as parent:
                result = chain.machine.verify(parent, height, maker.at_ms, calls)
            made = maker.of_result(result, calls)
            if made.block_id != block.block_id:
                raise BlockRobotError("BLOCK_INVALID", f"Executed anew, block {height} is another one.")
            await target.commit([made], newer.finality if height == position.height else maker.finality())
            count += 1
    return count
