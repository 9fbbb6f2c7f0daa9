"""Keys, genesis and machine shared by all simulated networks of one size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from consensus.chain.genesis import GENESIS_VERSION, ChainSettings, Genesis, NodeEntry, Organisation, prove_possession
from consensus.limits import TIME_BUCKET_MS
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey, verify
from consensus.rights.purposes import PURPOSES
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.genesis import complete_genesis
from contracts.lifecycle.registry import contract_entries
from contracts.vm import LANGUAGE_VERSION
from network.sim.plan import CUSTODY_FOUNDING_COUNT, NetworkSize
from network.sim.world.cpu import COSTS, charge
from node.execution.block_executor import genesis_block
from node.mempool.transaction_cache import TransactionCache
from node.storage.ledger_store import FinalizedBlock

EPOCH_MS = 1_800_000_000_000 - 1_800_000_000_000 % TIME_BUCKET_MS
ORGANISATIONS_COUNT = 2
SIGNATURES_MAX_COUNT = 65_536
_ORGANISATIONS = ("hospital", "university")


def make_key(name: str) -> PrivateKey:
    return PrivateKey(sha256(b"simulated " + name.encode()))


def node_name(index: int) -> str:
    return f"node-{index + 1}"


def is_custodian(index: int, size: NetworkSize) -> bool:
    return size.all_keep or index < ORGANISATIONS_COUNT


class SharedCheck:
    """Checks each signature once per process; remembers forged ones too."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], bool] = {}

    def __call__(self, public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool:
        place = (public_key, tag, signature, parts)
        known = self._known.get(place)
        if known is None:
            known = verify(public_key, tag, signature, *parts)
            self._remember(place, genuine=known)
        return known

    def note_signed(self, public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> None:
        self._remember((public_key, tag, signature, parts), genuine=True)

    def _remember(self, place: tuple[object, ...], *, genuine: bool) -> None:
        if len(self._known) >= SIGNATURES_MAX_COUNT:
            self._known.clear()
        self._known[place] = genuine


class TrustedKey(PrivateKey):
    """A node's key; its signatures are remembered as genuine."""

    __slots__ = ("_check",)

    def __init__(self, secret: bytes, check: SharedCheck) -> None:
        super().__init__(secret)
        self._check = check

    def sign_compact(self, tag: str, *parts: bytes) -> bytes:
        charge(COSTS.signing)
        signature = super().sign_compact(tag, *parts)
        self._check.note_signed(self.public_key, tag, signature, *parts)
        return signature


@dataclass(frozen=True)
class Chain:
    """What networks of one size share; its caches change no history."""

    genesis: Genesis
    first_block: FinalizedBlock
    producers: tuple[TrustedKey, ...]
    custodians: tuple[PrivateKey | None, ...]
    registrar: PrivateKey
    admins: tuple[PrivateKey, ...]
    machine: ContractMachine
    check: SharedCheck
    transactions: TransactionCache


def make_node_entry(index: int, key: PrivateKey | None, custodian: PrivateKey | None = None) -> NodeEntry:
    """Organisations alternate."""
    return NodeEntry(
        name=node_name(index),
        organisation=_ORGANISATIONS[index % ORGANISATIONS_COUNT],
        host="127.0.0.1",
        p2p_port=1000 + 10 * index,
        api_url=f"http://127.0.0.1:{1001 + 10 * index}",
        producer_key=b"" if key is None else key.public_key,
        producer_possession=b"" if key is None else prove_possession(key, node_name(index)),
        custodian_key=b"" if custodian is None else custodian.public_key,
    )


@cache
def make_chain(size: NetworkSize) -> Chain:
    nodes = size.nodes
    check = SharedCheck()
    producers = tuple(TrustedKey(make_key(f"producer {index}").secret, check) for index in range(nodes))
    custodians = tuple(make_key(f"custodian {index}") if is_custodian(index, size) else None for index in range(nodes))
    organisations = _ORGANISATIONS[: min(ORGANISATIONS_COUNT, nodes)]
    admins = tuple(make_key(f"admin {name}") for name in organisations)
    registrar = make_key(f"registrar {organisations[0]}")
    genesis = complete_genesis(
        Genesis(
            version=GENESIS_VERSION,
            network="simulated",
            created_at_ms=EPOCH_MS,
            settings=ChainSettings(),
            organisations=tuple(
                Organisation(
                    name=name,
                    ca_certificate="",
                    admins=(admin.public_key,),
                    registrars=(make_key(f"registrar {name}").public_key,),
                )
                for name, admin in zip(organisations, admins, strict=True)
            ),
            nodes=tuple(
                make_node_entry(index, producers[index] if index < size.producers else None, custodians[index])
                for index in range(max(size.producers, CUSTODY_FOUNDING_COUNT if size.all_keep else 0))
            ),
            contracts=contract_entries(),
            purposes=tuple(PURPOSES),
            state_root=b"",
            contract_language=LANGUAGE_VERSION,
        )
    )
    return Chain(
        genesis=genesis,
        first_block=genesis_block(genesis),
        producers=producers,
        custodians=custodians,
        registrar=registrar,
        admins=admins,
        machine=ContractMachine.of_genesis(genesis),
        check=check,
        transactions=TransactionCache(),
    )
