"""A small hospital on a chain of its own: one registrar, two custodians, robots and people, one block per call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from consensus.chain.block import Receipt
from consensus.chain.genesis import ChainSettings, Genesis, NodeEntry, Organisation
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.limits import RETENTION_DEFAULT_MS, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.members.vouchers import Card, issue_card, sign_card, sign_rotation
from consensus.primitives.encoding import decode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.commitments import derive_record_id
from consensus.records.owner_keys import derive_owner_key, open_visit_keys, sign_transfer
from consensus.rights.purposes import PURPOSES
from contracts.execution.executor import execute_block
from contracts.execution.genesis import complete_genesis, open_genesis
from contracts.execution.results import BlockContext
from contracts.execution.views import run_view
from contracts.lifecycle.registry import contract_entries, load_contracts
from contracts.state.view import MemoryState

START_MS = 1_700_000_100_000 - 1_700_000_100_000 % TIME_BUCKET_MS + 60_000
DAY_MS = 24 * 3600 * 1000


def key_of(name: str) -> PrivateKey:
    """A key that is always the same for a name."""
    return PrivateKey(sha256(name.encode()))


@dataclass
class Person:
    """Somebody with the four keys; `handle` is set once registered."""

    name: str
    role: str = "subject"
    handle: bytes = b""

    @property
    def identity(self) -> PrivateKey:
        return key_of(self.name + "/identity")

    @property
    def spend(self) -> PrivateKey:
        return key_of(self.name + "/spend")

    @property
    def view(self) -> PrivateKey:
        return key_of(self.name + "/view")

    @property
    def sealing(self) -> bytes:
        return sha256(self.name.encode() + b"/sealing")


@dataclass
class Visit:
    """One visit: its owner's private key and what is on the chain of it."""

    key: PrivateKey
    robot: Person
    bucket_ms: int
    records: list[bytes] = field(default_factory=list)

    @property
    def owner(self) -> bytes:
        return self.key.public_key


def build_genesis(custodians: Sequence[str] = ("custodian-1", "custodian-2")) -> Genesis:
    """One organisation with an admin and a registrar; its nodes are all custodians."""
    nodes = tuple(
        NodeEntry(
            name=name,
            organisation="ward",
            host="127.0.0.1",
            p2p_port=1,
            api_url="http://127.0.0.1:2",
            producer_key=key_of(name + "/producer").public_key,
            producer_possession=b"",
            custodian_key=key_of(name).public_key,
        )
        for name in custodians
    )
    ward = Organisation(
        name="ward",
        ca_certificate="",
        admins=(key_of("admin").public_key,),
        registrars=(key_of("registrar").public_key,),
    )
    genesis = Genesis(
        version=1,
        network="test",
        created_at_ms=START_MS - 1000,
        settings=ChainSettings(),
        organisations=(ward,),
        nodes=nodes,
        contracts=contract_entries(),
        purposes=tuple(PURPOSES),
        state_root=b"",
    )
    return complete_genesis(genesis)


class Hospital:
    """The chain: each `send` is a block of one transaction, 100 ms after the one before."""

    custodian_names: tuple[str, ...] = ("custodian-1", "custodian-2")

    def __init__(self) -> None:
        self.genesis = build_genesis(self.custodian_names)
        self.chain_id = self.genesis.chain_id
        first = open_genesis(self.genesis)
        self.state = MemoryState()
        self.state.absorb(first.writes, first.pages, first.state_root)
        self.contracts = load_contracts()
        self.registrar, self.admin = key_of("registrar"), key_of("admin")
        self.custodians = [key_of(name) for name in self.custodian_names]
        self.height = 0
        self.time_ms = START_MS
        self._salt = 0
        self.robot = self.enrol("robot", "robot")

    # Blocks

    def sign(self, key: PrivateKey, contract: str, entry: str, *arguments: Any) -> Transaction:
        self._salt += 1
        return sign_transaction(
            key,
            chain_id=self.chain_id,
            contract=contract,
            entry=entry,
            arguments=list(arguments),
            valid_until_ms=self.time_ms + 60_000,
            salt=self._salt.to_bytes(8, "big"),
        )

    def context(self) -> BlockContext:
        return BlockContext(chain_id=self.chain_id, height=self.height, time_ms=self.time_ms)

    def block(self, transactions: list[Transaction]) -> list[Receipt]:
        self.height += 1
        self.time_ms += 100
        result = execute_block(self.state, self.contracts, self.context(), transactions)
        self.state.absorb(result.writes, result.page_writes, result.state_root)
        return list(result.receipts)

    def send(self, key: PrivateKey, contract: str, entry: str, *arguments: Any) -> Receipt:
        return self.block([self.sign(key, contract, entry, *arguments)])[0]

    def must(self, key: PrivateKey, contract: str, entry: str, *arguments: Any) -> Receipt:
        receipt = self.send(key, contract, entry, *arguments)
        assert receipt.ok, f"{receipt.code}: {receipt.message} (line {receipt.line})"
        return receipt

    def value(self, contract: str, key: bytes) -> Any:
        data = self.state.get(contract.encode() + b"\x00" + key)
        return None if data is None else decode_value(data)

    def view(self, contract: str, name: str, *arguments: Any) -> Any:
        return run_view(self.state, self.contracts, self.context(), contract, name, list(arguments))

    # People

    def card(self, name: str, role: str = "subject", **changes: Any) -> Card:
        return issue_card(
            changes.get("registrar", self.registrar),
            chain_id=changes.get("chain_id", self.chain_id),
            handle=changes.get("handle", sha256(name.encode() + b"/handle")),
            card_secret=sha256(name.encode() + b"/card"),
            role=role,
            not_after_ms=changes.get("not_after_ms", self.time_ms + DAY_MS),
        )

    def register_arguments(self, person: Person, card: Card, **changes: Any) -> list[Any]:
        keys = {
            "member": person.identity.public_key,
            "spend": person.spend.public_key,
            "view": person.view.public_key,
            "sealing": person.sealing,
        }
        signature = sign_card(card, chain_id=self.chain_id, **keys)
        return [
            card.handle,
            card.card_public,
            changes.get("role", card.role),
            changes.get("not_after_ms", card.not_after_ms),
            card.voucher_signature,
            keys["spend"],
            keys["view"],
            keys["sealing"],
            signature,
            changes.get("purposes", ["care", "demo"]),
        ]

    def enrol(self, name: str, role: str = "subject") -> Person:
        person, card = Person(name, role), self.card(name, role)
        self.must(person.identity, "identity", "register", *self.register_arguments(person, card))
        person.handle = card.handle
        return person

    # Visits and records

    def rotation_arguments(self, old: Person, new: Person) -> list[Any]:
        """Return the arguments by which a member takes new keys."""
        keys = [new.spend.public_key, new.view.public_key, new.sealing]
        agreed = sign_rotation(
            new.identity,
            chain_id=self.chain_id,
            handle=old.handle,
            member=old.identity.public_key,
            spend=keys[0],
            view=keys[1],
            sealing=keys[2],
        )
        return [old.handle, new.identity.public_key, *keys, agreed]

    def bucket(self) -> int:
        return self.time_ms - self.time_ms % TIME_BUCKET_MS

    def visit_of(self, person: Person, number: int = 0, robot: Person | None = None) -> tuple[Visit, list[Any]]:
        """Make the keys of a visit; return it and the arguments that open it."""
        robot = robot or self.robot
        robot_key = robot.identity.public_key
        secret = sha256(f"{person.name}/{number}".encode())
        keys = open_visit_keys(
            secret, person.view.public_key, person.spend.public_key, chain_id=self.chain_id, robot=robot_key
        )
        key = derive_owner_key(person.spend, person.view, keys.ephemeral, chain_id=self.chain_id, robot=robot_key)
        visit = Visit(key, robot, self.bucket())
        return visit, [keys.owner, keys.ephemeral, keys.view_tag, visit.bucket_ms, "care"]

    def open_visit(self, person: Person, number: int = 0, robot: Person | None = None) -> Visit:
        visit, arguments = self.visit_of(person, number, robot)
        self.must(visit.robot.identity, "records", "open_visit", *arguments)
        return visit

    def transfer_arguments(self, root: bytes, person: Person, number: int = 99) -> tuple[PrivateKey, list[Any]]:
        """Make a person's new owner key for a visit of the robot; return it and the arguments that put it in place."""
        new, (owner, ephemeral, view_tag, *_) = self.visit_of(person, number)
        agreed = sign_transfer(new.key, chain_id=self.chain_id, root=root)
        return new.key, [owner, ephemeral, view_tag, agreed]

    def transfer(self, visit: Visit, person: Person, number: int = 99, key: PrivateKey | None = None) -> PrivateKey:
        """Transfer a visit to a new key of a person's, signed by its first key unless another is named."""
        new, arguments = self.transfer_arguments(visit.owner, person, number)
        self.must(key or visit.key, "records", "transfer", *arguments)
        return new

    def record_arguments(self, visit: Visit, number: int = 0, **changes: Any) -> list[Any]:
        seed = visit.owner + number.to_bytes(4, "big")
        root = sha256(seed + b"c")
        values = {
            "record_id": derive_record_id(visit.owner, root),
            "owner": visit.owner,
            "commitment_root": root,
            "ciphertext_root": sha256(seed + b"t"),
            "sealed_metadata": bytes(SEALED_METADATA_BYTES),
            "bucket_ms": self.bucket(),
            "expires_at_ms": self.time_ms + RETENTION_DEFAULT_MS,
        }
        return list({**values, **changes}.values())

    def record(self, visit: Visit, number: int | None = None, **changes: Any) -> bytes:
        arguments = self.record_arguments(visit, len(visit.records) if number is None else number, **changes)
        self.must(visit.robot.identity, "records", "record", *arguments)
        visit.records.append(arguments[0])
        return bytes(arguments[0])

    def receipts_of_all(self, erasure_id: bytes, destroyed: int = 1) -> list[Receipt]:
        """Every custodian confirms an erasure."""
        return [
            self.must(custodian, "erasure", "receipt", erasure_id, destroyed, "backups of the host", 0, bytes(32))
            for custodian in self.custodians
        ]


def data_of(receipt: Receipt, name: str) -> dict[str, Any]:
    """Return the data of the one event of this name."""
    found = [decode_value(event.data) for event in receipt.events if event.name == name]
    assert len(found) == 1, [event.name for event in receipt.events]
    return dict(found[0])
