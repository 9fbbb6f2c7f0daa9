"""What is looked at after the last day: wallets' audits, a node from a snapshot, and one from a backup."""

from __future__ import annotations

import asyncio
import random
import shutil
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple, cast

from nacl.pwhash import argon2id

from clients.sdk.passphrase import PassphraseCost
from clients.wallet.ledger.visit_audit import AuditEntry, audit_all
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import Keystore
from consensus.primitives.keys import PrivateKey
from network.bench.growth.growth_on_clients import LocalClient
from network.lab.year.chain import HospitalChain, follow_blocks, read_block
from network.lab.year.custody import CustodianPlace, Custodians, open_place
from network.lab.year.life import Hospital
from network.lab.year.people import Person
from network.provisioning.node_backup import back_up, restore
from node.config import NodeConfig
from node.custody.chain_facts import ChainFacts
from node.custody.finalized_events import collect_events
from node.custody.stores.custody_store import Checkpoint
from node.snapshot.making import make_snapshot_folder
from node.snapshot.restoring import restore_ledger
from node.snapshot.snapshot_format import SnapshotFolder
from node.storage.lmdb_store import LmdbStore

if TYPE_CHECKING:
    from clients.sdk.network_client import NetworkClient

AUDITED_MEMBERS_COUNT = 20
_CHEAPEST = PassphraseCost(argon2id.OPSLIMIT_MIN, argon2id.MEMLIMIT_MIN)
EXPIRED_KIND = "expired"


def size_of(folder: Path) -> int:
    """In bytes on the disk, without what links lead to."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    return sum(512 * path.stat().st_blocks for path in files)


class Audits(NamedTuple):
    """Audits of some members' wallets."""

    members: int
    entries: int
    seconds: float
    troubles: list[str]


async def audit_members(hospital: Hospital, chain: HospitalChain, seed: int) -> Audits:
    """Each as a wallet made anew from its words does it; what it finds is held against what was done."""
    dice = random.Random(f"audits {seed}")  # noqa: S311 - a simulation's dice
    numbers = sorted(hospital.members)
    chosen = dice.sample(numbers, min(AUDITED_MEMBERS_COUNT, len(numbers)))
    entries_count, troubles, started_s = 0, [], time.perf_counter()
    for number in chosen:
        person = hospital.members[number]
        with TemporaryDirectory(prefix="blockrobot-wallet-") as folder:
            wallet = await _open_wallet(person, chain, Path(folder))
            entries = await audit_all(wallet)
            entries_count += len(entries)
            troubles += _compare(person, entries)
            for report in await wallet.records():
                if report.missing_count or report.unreadable_ids:
                    troubles.append(f"the wallet of {person.name} misses records of a visit, or cannot read them")
    return Audits(len(chosen), entries_count, time.perf_counter() - started_s, troubles)


async def _open_wallet(person: Person, chain: HospitalChain, folder: Path) -> Wallet:
    *former, words = person.words
    store = await asyncio.to_thread(Keystore.create, folder / "wallet", words, "year", _CHEAPEST, former=former)
    wallet = Wallet(store, chain.genesis)
    await wallet.network.close()
    wallet.network = cast("NetworkClient", LocalClient(chain.store, chain.genesis))
    store.content.handle = person.handle
    return wallet


def _compare(person: Person, entries: list[AuditEntry]) -> list[str]:
    found: dict[bytes, Counter[str]] = {visit.owner: Counter() for visit in person.visits}
    for entry in entries:
        if entry.owner not in found:
            return [f"the audit of {person.name} has a visit that was not made"]
        found[entry.owner][entry.kind] += 1
    troubles = []
    for visit in person.visits:
        trail = found[visit.owner]
        trail.pop(EXPIRED_KIND, None)
        if trail != visit.trail:
            troubles.append(f"the audit of {person.name} says {dict(trail)} of a visit, and not {dict(visit.trail)}")
    return troubles


class Started(NamedTuple):
    """A node that was begun from a copy."""

    size_bytes: int
    seconds: float
    clips_fetched: int
    troubles: list[str]


def keep_snapshot(chain: HospitalChain, folder: Path) -> None:
    with chain.store.snapshot() as snapshot:
        make_snapshot_folder(snapshot, folder)


def keep_backup(config: NodeConfig, folder: Path) -> None:
    """Of a node whose ledger is closed in this process."""
    back_up(config, folder, with_keys=True)


async def start_from_snapshot(chain: HospitalChain, snapshot: Path, folder: Path) -> Started:
    """Restore the ledger, and execute every block that came since."""
    started_s = time.perf_counter()
    await asyncio.to_thread(restore_ledger, SnapshotFolder(snapshot), chain.genesis, folder)
    store = LmdbStore.open(folder)
    try:
        blocks = await follow_blocks(chain.chain, chain.store, store)
        seconds = time.perf_counter() - started_s
        troubles = _differences("the node from the snapshot", chain.store, store, blocks)
    finally:
        await store.close()
    size_bytes = size_of(snapshot)
    for place in (snapshot, folder):
        shutil.rmtree(place)
    return Started(size_bytes, seconds, 0, troubles)


def _differences(who: str, wanted: LmdbStore, found: LmdbStore, blocks: int) -> list[str]:
    if found.position != wanted.position:
        return [f"{who} ends at {found.position}, and not at {wanted.position}"]
    return [] if blocks else [f"{who} had nothing to catch up with"]


async def restore_backup(
    chain: HospitalChain, custodians: Custodians, backup: Path, folder: Path, key: PrivateKey
) -> Started:
    """Of the first node, with the erase keys of now: then ledger and custodian follow what came since."""
    first, *others = custodians.places
    started_s = time.perf_counter()
    restored = await asyncio.to_thread(
        restore, backup, folder, erase_keys=first.config.erase_keys_dir, genesis=chain.genesis
    )
    store = LmdbStore.open(restored.config.ledger_dir)
    try:
        async with open_place(restored.config, key, lambda: chain.now_ms) as place:
            with store.snapshot() as snapshot:
                at = snapshot.position
                assert at is not None, "a restored ledger has a state"
                point = Checkpoint(at.height, at.block_id, at.timestamp_ms)
                await place.custodian.reconcile(ChainFacts(snapshot, point))
            blocks = await follow_blocks(chain.chain, chain.store, store)
            fetched = await _catch_up(place, chain, others)
            seconds = time.perf_counter() - started_s
            report = await place.scrub(store)
        troubles = _differences("the node from the backup", chain.store, store, blocks)
    finally:
        await store.close()
    # A network of one custodian has nobody who could give what came after the backup.
    if not report.nothing_erased_is_left or (others and not report.is_clean):
        troubles.append(f"the scrub of the restored custodian is not clean: {report}")
    size_bytes = size_of(backup)
    for place_of in (backup, folder):
        shutil.rmtree(place_of)
    return Started(size_bytes, seconds, fetched, troubles)


async def _catch_up(place: CustodianPlace, chain: HospitalChain, others: list[CustodianPlace]) -> int:
    point = await place.custodian.checkpoint()
    assert point is not None, "it follows from the restored state on"
    with chain.store.snapshot() as snapshot:
        for height in range(point.height + 1, chain.height + 1):
            block, receipts = read_block(snapshot, height)
            at_ms = block.header.timestamp_ms
            await place.custodian.on_finalized_block(collect_events(height, block.block_id, at_ms, receipts))
    fetched = 0
    while others and (count := await place.custodian.fetch_missing(others)):
        fetched += count
    return fetched
