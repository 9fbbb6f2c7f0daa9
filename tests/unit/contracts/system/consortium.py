"""A consortium on a chain of its own: organisations with admins, their nodes, candidates; one block per call."""

from __future__ import annotations

from typing import Any

from consensus.chain.block import Receipt
from consensus.chain.epoch_settings import Epoch
from consensus.chain.genesis import ChainSettings, Genesis, NodeEntry, Organisation, prove_possession
from consensus.chain.messages import PROPOSAL_TAG, VOTE_TAG
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.primitives.encoding import decode_value, u32, u64
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.rights.purposes import PURPOSES
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.epochs import next_epoch, read_epoch
from contracts.execution.genesis import complete_genesis, open_genesis
from contracts.execution.results import BlockContext
from contracts.execution.views import run_view
from contracts.lifecycle.catalogue import ActiveContracts, Catalogue
from contracts.lifecycle.registry import contract_entries
from contracts.state.view import MemoryState

START_MS = 1_700_000_000_000
DAY_MS = 24 * 3600 * 1000
CERTIFICATE = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"
TAGS = {"vote": VOTE_TAG, "proposal": PROPOSAL_TAG}


def key_of(name: str) -> PrivateKey:
    """A key that is always the same for a name."""
    return PrivateKey(sha256(name.encode()))


def admin_of(organisation: str) -> PrivateKey:
    """The admin's key of an organisation."""
    return key_of(organisation + "/admin")


def producer_of(node: str) -> PrivateKey:
    """The first producer key of a node."""
    return key_of(node + "/producer")


def organisation_name(number: int) -> str:
    """Return org-01 for 1; two digits, so that names sort as numbers do."""
    return f"org-{number:02d}"


def node_fields(
    name: str, organisation: str, *, custodian: bool = False, key: PrivateKey | None = None
) -> dict[str, Any]:
    """The arguments of `add_node`."""
    producer = key or producer_of(name)
    return {
        "name": name,
        "organisation": organisation,
        "host": "127.0.0.1",
        "p2p_port": 4100,
        "api_url": "http://127.0.0.1:4101",
        "producer_key": producer.public_key,
        "producer_possession": prove_possession(producer, name),
        "custodian_key": key_of(name + "/custodian").public_key if custodian else b"",
    }


def organisation_fields(name: str) -> dict[str, Any]:
    """The arguments of `add_org`."""
    registrars = [key_of(name + "/registrar").public_key]
    return {
        "name": name,
        "ca_certificate": CERTIFICATE,
        "admins": [admin_of(name).public_key],
        "registrars": registrars,
    }


def build_genesis(organisations: int, nodes: int, settings: ChainSettings) -> Genesis:
    """Organisations org-01... with nodes node-01... in turn; the first node of each is a custodian."""
    return complete_genesis(
        Genesis(
            version=1,
            network="test",
            created_at_ms=START_MS - 1000,
            settings=settings,
            organisations=tuple(
                Organisation(
                    name=organisation_name(number),
                    ca_certificate=CERTIFICATE,
                    admins=(admin_of(organisation_name(number)).public_key,),
                    registrars=(key_of(organisation_name(number) + "/registrar").public_key,),
                )
                for number in range(1, organisations + 1)
            ),
            nodes=tuple(
                NodeEntry(
                    **node_fields(
                        f"node-{number:02d}",
                        organisation_name((number - 1) % organisations + 1),
                        custodian=number <= organisations,
                    )
                )
                for number in range(1, nodes + 1)
            ),
            contracts=contract_entries(),
            purposes=tuple(PURPOSES),
            state_root=b"",
        )
    )


class Consortium:
    """The chain: each `send` is a block of one transaction, 100 ms after the one before."""

    def __init__(self, organisations: int = 3, nodes: int = 4, settings: ChainSettings | None = None) -> None:
        self.genesis = build_genesis(organisations, nodes, settings or ChainSettings())
        self.chain_id = self.genesis.chain_id
        first = open_genesis(self.genesis)
        self.state = MemoryState()
        self.state.absorb(first.writes, first.pages, first.state_root)
        self.catalogue = Catalogue()
        self.machine = ContractMachine(self.chain_id, self.catalogue)
        self.organisations = [organisation_name(number) for number in range(1, organisations + 1)]
        self.height = 0
        self.time_ms = START_MS
        self.boundaries: list[tuple[int, Epoch]] = []
        self._salt = 0

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
        before = self.epoch
        result = self.machine.verify(self.state, self.height, self.time_ms, transactions)
        self.state.absorb(result.writes, result.page_writes, result.state_root)
        following = next_epoch(result.writes, before.number)
        if following is not None:
            self.boundaries.append((self.height, following))
        return list(result.receipts)

    def send(self, key: PrivateKey, contract: str, entry: str, *arguments: Any) -> Receipt:
        return self.block([self.sign(key, contract, entry, *arguments)])[0]

    def must(self, key: PrivateKey, contract: str, entry: str, *arguments: Any) -> Receipt:
        receipt = self.send(key, contract, entry, *arguments)
        assert receipt.ok, f"{receipt.code}: {receipt.message} (line {receipt.line})"
        return receipt

    def refused(self, code: str, key: PrivateKey, contract: str, entry: str, *arguments: Any) -> None:
        """The call fails with this code and a sentence, and changes nothing."""
        root = self.state.state_root
        receipt = self.send(key, contract, entry, *arguments)
        assert (receipt.ok, receipt.code) == (False, code), f"{receipt.code}: {receipt.message} (line {receipt.line})"
        assert receipt.message.endswith(".")
        assert self.state.state_root == root

    # State

    @property
    def contracts(self) -> ActiveContracts:
        return self.catalogue.active(self.state)

    @property
    def epoch(self) -> Epoch:
        return read_epoch(self.state)

    @property
    def seats(self) -> list[str]:
        """The names of the nodes in the schedule, in the order of their turns."""
        return [self.candidate(key)["name"] for key in self.epoch.producers]

    def value(self, contract: str, key: bytes) -> Any:
        data = self.state.get(contract.encode() + b"\x00" + key)
        return None if data is None else decode_value(data)

    def view(self, contract: str, name: str, *arguments: Any) -> Any:
        return run_view(self.state, self.contracts, self.context(), contract, name, list(arguments))

    def candidate(self, key: bytes) -> dict[str, Any]:
        return dict(self.value("producers", b"candidate/" + key))

    # What organisations do

    def active(self) -> list[str]:
        return list(self.value("membership", b"organisations"))

    def majority(self) -> list[str]:
        names = self.active()
        return names[: len(names) // 2 + 1]

    def agree(self, kind: str, arguments: dict[str, Any]) -> Receipt:
        """One proposes a change of membership, and a majority approves."""
        first, *others = self.majority()
        receipt = self.must(admin_of(first), "membership", "propose", kind, arguments)
        proposal_id = receipt.txid
        for name in others:
            receipt = self.must(admin_of(name), "membership", "approve", proposal_id)
        assert self.value("membership", b"proposal/" + proposal_id)["status"] == "executed"
        return receipt

    def agree_setting(self, name: str, value: Any) -> Receipt:
        first, *others = self.majority()
        receipt = self.must(admin_of(first), "settings", "propose", name, value)
        proposal_id = receipt.txid
        for other in others:
            receipt = self.must(admin_of(other), "settings", "approve", proposal_id)
        return receipt

    def vote_in(self, key: bytes) -> None:
        """A majority makes the key a candidate and votes for it."""
        first, *others = self.majority()
        self.must(admin_of(first), "producers", "propose", key)
        for name in others:
            self.must(admin_of(name), "producers", "approve", key)

    def ready(self, node: str, key: PrivateKey | None = None) -> Receipt:
        return self.must(key or producer_of(node), "producers", "ready", self.height, self.state.state_root)

    def grow(self, *nodes: str) -> None:
        """Add nodes of the first organisation, vote for them and let them say that they are ready."""
        for name in nodes:
            self.agree("add_node", node_fields(name, self.active()[0]))
            self.vote_in(producer_of(name).public_key)
            self.ready(name)

    def evidence(
        self, key: PrivateKey, kind: str = "vote", round_number: int = 7, epoch: int | None = None
    ) -> list[Any]:
        """The arguments of `accuse`: two ids that the key signed in one round."""
        number = self.epoch.number if epoch is None else epoch
        first, second = sorted((sha256(b"one"), sha256(b"two")))
        before = (self.chain_id, u32(number), u64(round_number))
        signatures = [key.sign_compact(TAGS[kind], *before, block_id) for block_id in (first, second)]
        return [kind, number, round_number, key.public_key, first, signatures[0], second, signatures[1]]


def data_of(receipt: Receipt, name: str) -> dict[str, Any]:
    """Return the data of the one event of this name."""
    found = [decode_value(event.data) for event in receipt.events if event.name == name]
    assert len(found) == 1, [event.name for event in receipt.events]
    return dict(found[0])
