"""The public genesis file, a client's root of trust."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from consensus.bounded_text import read_json_text
from consensus.chain.block import HEADER_VERSION, NO_BLOCK, Block, Header, QuorumCertificate, compute_header_id
from consensus.chain.epoch_settings import ChainSettings, Epoch, check_settings, parse_production
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, encode, encode_value
from consensus.primitives.hashing import HASH_SIZE_BYTES, tagged_hash
from consensus.primitives.keys import PrivateKey, is_public_key, verify
from consensus.primitives.merkle import merkle_root

__all__ = [
    "GENESIS_VERSION",
    "PARTS",
    "POSSESSION_TAG",
    "ChainSettings",
    "ContractEntry",
    "Genesis",
    "NodeEntry",
    "Organisation",
    "genesis_from_json",
    "genesis_to_json",
    "parse_production",
    "prove_possession",
    "require_possession",
]

GENESIS_VERSION = 1
PARTS = ("name or beginning", "settings", "organisations", "nodes", "contracts", "purposes")
"""Of a genesis file, as they are called where two differ."""
POSSESSION_TAG = "blockrobot/producer-possession"


class Organisation(Wire, frozen=True):
    """An organisation: name, CA certificate (PEM), admin and registrar keys (33 bytes)."""

    name: str
    ca_certificate: str
    admins: tuple[bytes, ...]
    registrars: tuple[bytes, ...]


class NodeEntry(Wire, frozen=True):
    """A node: operator, address and keys (33 bytes; empty without that role)."""

    name: str
    organisation: str
    host: str
    p2p_port: int
    api_url: str
    producer_key: bytes
    producer_possession: bytes
    custodian_key: bytes


class ContractEntry(Wire, frozen=True):
    """A genesis contract: name and SHA-256 of its source."""

    name: str
    source_hash: bytes


class Genesis(Wire, frozen=True):
    """The whole file; `state_root` follows the genesis entries and is outside the chain id.

    All nodes must agree on `contract_language`, which has gas prices.
    """

    version: int
    network: str
    created_at_ms: int
    settings: ChainSettings
    organisations: tuple[Organisation, ...]
    nodes: tuple[NodeEntry, ...]
    contracts: tuple[ContractEntry, ...]
    purposes: tuple[str, ...]
    state_root: bytes
    contract_language: int = 5

    @property
    def chain_id(self) -> bytes:
        return tagged_hash("blockrobot/chain", encode(msgspec.structs.replace(self, state_root=b"")))

    @property
    def part_digests(self) -> tuple[bytes, ...]:
        """Eight bytes for each of PARTS, by which two networks find out in which their files differ."""
        parts = (
            (self.version, self.network, self.created_at_ms),
            self.settings,
            self.organisations,
            self.nodes,
            (self.contracts, self.contract_language),
            self.purposes,
        )
        return tuple(tagged_hash("blockrobot/genesis-part", encode_value(_as_lists(part)))[:8] for part in parts)

    @property
    def epoch(self) -> Epoch:
        producers = tuple(node.producer_key for node in self.nodes if node.producer_key)
        return Epoch(number=0, producers=producers, leaderless=(), settings=self.settings)

    @property
    def schedule(self) -> Schedule:
        return Schedule.of(self.epoch)

    @property
    def custodians(self) -> tuple[NodeEntry, ...]:
        return tuple(node for node in self.nodes if node.custodian_key)

    def node(self, name: str) -> NodeEntry:
        """Raises GENESIS_INVALID."""
        for node in self.nodes:
            if node.name == name:
                return node
        raise BlockRobotError("GENESIS_INVALID", f"The genesis file names no node {name!r}.")

    def block(self) -> Block:
        empty_root = merkle_root([])
        header = Header(
            version=HEADER_VERSION,
            chain_id=self.chain_id,
            epoch=0,
            height=0,
            round=0,
            parent_id=NO_BLOCK,
            qc=QuorumCertificate(epoch=0, round=0, block_id=NO_BLOCK, votes=()),
            tc=None,
            producer=0,
            timestamp_ms=self.created_at_ms,
            transactions_root=empty_root,
            receipts_root=empty_root,
            state_root=self.state_root,
            next_schedule_hash=None,
            gas_used=0,
        )
        return Block(header_bytes=encode(header), signature=b"", transactions=())

    @property
    def block_id(self) -> bytes:
        return compute_header_id(self.block().header)


def _as_lists(value: Any) -> Any:
    if isinstance(value, msgspec.Struct):
        return [_as_lists(field) for field in msgspec.structs.astuple(value)]
    return [_as_lists(item) for item in value] if isinstance(value, tuple | list) else value


def _check_nodes(genesis: Genesis) -> None:
    names = [node.name for node in genesis.nodes]
    keys = [key for node in genesis.nodes for key in (node.producer_key, node.custodian_key) if key]
    if len(set(names)) != len(names) or len(genesis.state_root) != HASH_SIZE_BYTES:
        raise BlockRobotError("GENESIS_INVALID", "Two nodes share a name, or the state root has a wrong size.")
    if not all(is_public_key(key) for key in keys):
        raise BlockRobotError("GENESIS_INVALID", "A node's key is no public key.")


def _bytes_to_hex(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, msgspec.Struct):
        return {name: _bytes_to_hex(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, tuple | list):
        return [_bytes_to_hex(item) for item in value]
    return value


def genesis_to_json(genesis: Genesis) -> str:
    return json.dumps(_bytes_to_hex(genesis), indent=2, ensure_ascii=False) + "\n"


def _named(kind: type[Wire], value: Any) -> list[Any]:
    names = kind.__struct_fields__
    if not isinstance(value, dict) or set(value) != set(names):
        raise BlockRobotError("GENESIS_INVALID", f"The part {kind.__name__} of the genesis file has wrong fields.")
    return [_from_hex(field.type, value[field.name]) for field in msgspec.structs.fields(kind)]


def _from_hex(kind: Any, value: Any) -> Any:
    if kind is bytes:
        return bytes.fromhex(value)
    if kind == tuple[bytes, ...]:
        return [bytes.fromhex(item) for item in value]
    return value


def genesis_from_json(text: str | bytes) -> Genesis:
    """Raises GENESIS_INVALID."""
    try:
        raw = read_json_text(text)
        fields = dict(zip(Genesis.__struct_fields__, _named(Genesis, raw), strict=True))
        fields["settings"] = _named(ChainSettings, fields["settings"])
        fields["organisations"] = [_named(Organisation, part) for part in fields["organisations"]]
        fields["nodes"] = [_named(NodeEntry, part) for part in fields["nodes"]]
        fields["contracts"] = [_named(ContractEntry, part) for part in fields["contracts"]]
        genesis = msgspec.convert(list(fields.values()), Genesis, builtin_types=(bytes,))
        encode(genesis)  # a number beyond 64 bits or half a character has no canonical form
    except (ValueError, TypeError, RecursionError, OverflowError) as error:
        raise BlockRobotError("GENESIS_INVALID", f"The genesis file cannot be read: {error}.") from None
    if genesis.version != GENESIS_VERSION:
        raise BlockRobotError(
            "GENESIS_INVALID", f"The genesis file has version {genesis.version}, not {GENESIS_VERSION}."
        )
    check_settings(genesis.settings)
    _check_nodes(genesis)
    return genesis


def prove_possession(key: PrivateKey, node: str) -> bytes:
    return key.sign_compact(POSSESSION_TAG, node.encode())


def require_possession(genesis: Genesis) -> None:
    """Check all producers' proofs. Raises GENESIS_INVALID, naming the node."""
    for node in genesis.nodes:
        key, proof = node.producer_key, node.producer_possession
        if key and not verify(key, POSSESSION_TAG, proof, node.name.encode()):
            raise BlockRobotError("GENESIS_INVALID", f"The node {node.name!r} does not prove that it holds its key.")
