"""What clients' reading costs beside members and beside one person's visits: real proofs, checked, without HTTP."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from nacl.pwhash import argon2id

from clients.robot.consent.registry_reader import RegistryReader, RegistrySnapshot
from clients.robot.pairing.rosters import RosterBook
from clients.sdk.chain.announcements import AnnouncementPage, read_announcements
from clients.sdk.passphrase import PassphraseCost
from clients.sdk.proof_checks import ProofVerifier, ProvedState
from clients.wallet.ledger.visit_audit import audit_all
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import Keystore
from consensus.api_documents import ANNOUNCEMENTS_PAGE_MAX_COUNT, ProofsAnswer, finality_document
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient
from consensus.members.roster import ROSTER_ROWS_MAX_COUNT, ROSTER_VERSION, Roster
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.state.records import ANNOUNCEMENT, ANNOUNCEMENT_COUNT
from network.bench.growth.growth_ledgers import open_chain
from network.bench.growth.growth_on_ledger import Measured, open_growth
from network.bench.growth.growth_rows import ROBOT, roster_row
from network.bench.growth.growth_timing import Spent, Tell, time_operation, time_scan
from network.sim.world.sim_chain import EPOCH_MS
from node.api.routes.proofs import prove_keys
from node.api_adapters import DecodedSnapshot
from node.storage.ledger_store import LedgerStore

if TYPE_CHECKING:
    from clients.sdk.network_client import NetworkClient

ROSTER_PEOPLE_COUNT = 100
WORDS = " ".join(["abandon"] * 23 + ["art"])
"""A mnemonic that everybody knows, of nobody."""
_CHEAPEST = PassphraseCost(argon2id.OPSLIMIT_MIN, argon2id.MEMLIMIT_MIN)


class LocalClient:
    """Answers a client's questions from a ledger, through a node's proofs and the client's checks."""

    def __init__(self, ledger: LedgerStore, genesis: Genesis | None = None) -> None:
        genesis = genesis or open_chain().genesis
        self._ledger = ledger
        self._trust = ProofVerifier(genesis, LightClient(genesis))

    def _prove(self, keys: Sequence[bytes]) -> ProofsAnswer:
        with self._ledger.snapshot() as raw:
            snapshot, steps = DecodedSnapshot(raw), prove_keys(DecodedSnapshot(raw), keys)
            while True:
                try:
                    next(steps)
                except StopIteration as end:
                    return ProofsAnswer(finality=finality_document(snapshot.finality), proofs=end.value)

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:  # noqa: ARG002
        return self._trust.values(self._prove(keys), keys)

    async def announcements(self, first: int, key: PrivateKey) -> AnnouncementPage:  # noqa: ARG002
        limit = ANNOUNCEMENTS_PAGE_MAX_COUNT
        with self._ledger.snapshot() as snapshot:
            count = ANNOUNCEMENT_COUNT.read(snapshot) or 0
        numbers = range(first, min(first + limit, count))
        answer = self._prove([ANNOUNCEMENT_COUNT.flat, *map(ANNOUNCEMENT.key, numbers)])
        return read_announcements(self._trust, answer, first, limit)

    async def catch_up(self, key: PrivateKey) -> None: ...


def _reader(client: LocalClient, people: int) -> RegistryReader:
    roster = Roster(
        version=ROSTER_VERSION,
        chain_id=open_chain().genesis.chain_id,
        robot=ROBOT.public_key,
        key=sha256(b"roster"),
        issued_at_ms=EPOCH_MS,
        not_after_ms=EPOCH_MS + 1,
        rows=tuple(roster_row(number) for number in range(people)),
    )
    return RegistryReader(client, ROBOT, RosterBook(roster, open_chain().registrar.public_key))


async def measure_registry(folder: Path, size: int) -> Measured:
    async with open_growth(folder) as bench:
        client = LocalClient(bench.store)
        few, all_people = (_reader(client, min(size, most)) for most in (ROSTER_PEOPLE_COUNT, ROSTER_ROWS_MAX_COUNT))
        known = await few.read(None)

        async def renew(spent: Spent) -> None:
            with spent.once():
                await few.read(known)

        async def read(reader: RegistryReader, spent: Spent) -> RegistrySnapshot:
            with spent.once():
                return await reader.read(None)

        async def read_few(spent: Spent) -> None:
            if len((await read(few, spent)).people) != min(size, ROSTER_PEOPLE_COUNT):
                raise RuntimeError("the registry of the benchmark lacks people")

        async def read_all(_tell: Tell) -> None:
            await all_people.read(None)

        yield "registry synchronisation: nothing new", await time_operation(size, renew)
        yield "registry synchronisation: a roster of 100", await time_operation(size, read_few)
        if size <= ROSTER_ROWS_MAX_COUNT:
            yield "registry synchronisation: from nothing", await time_scan(size, read_all, is_watched=False)


async def measure_person(folder: Path, size: int) -> Measured:
    async with open_growth(folder) as bench:
        chain, path = open_chain(), folder / "wallet"
        path.unlink(missing_ok=True)
        store = await asyncio.to_thread(Keystore.create, path, WORDS, "growth", _CHEAPEST)
        wallet = Wallet(store, chain.genesis)
        await wallet.network.close()
        wallet.network = cast("NetworkClient", LocalClient(bench.store))
        store.content.handle = sha256(wallet.keys.identity.public_key)
        if len(await wallet.scan()) != size:
            raise RuntimeError("the wallet of the benchmark does not find its visits")

        async def records(_tell: Tell) -> None:
            reports = await wallet.records()
            if any(len(report.records) != 1 or report.missing_count for report in reports):
                raise RuntimeError("the wallet of the benchmark misses records")

        async def audit(_tell: Tell) -> None:
            await audit_all(wallet)

        async def report(spent: Spent) -> None:
            with spent.once():
                await wallet.visit_report(store.content.visits[size // 2])

        yield "wallet records: one visit of them", await time_operation(size, report)
        yield "wallet records", await time_scan(size, records, is_watched=False)
        yield "wallet audit", await time_scan(size, audit, is_watched=False)
