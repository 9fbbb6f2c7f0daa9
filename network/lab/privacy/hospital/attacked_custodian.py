"""The attacked hospital's custodian: the real one, on SQLite and erase-key file."""

from __future__ import annotations

import asyncio
import secrets
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from consensus.records.owner_keys import derive_owner_key
from consensus.records.sharing import GRANT_STEP_MS, hash_grant_member, open_grant_keys
from network.lab.privacy.attacks.ledger_view import VisitSeen, read_ledger
from network.lab.privacy.hospital.attacked_chain import Block
from network.lab.privacy.hospital.attacked_days import Played, day_of
from network.lab.privacy.hospital.household import PURPOSE
from network.sim.world.sim_cluster import quiet_logs
from node.custody.custodian import Custodian
from node.custody.erase_keys import EraseKeys
from node.custody.finalized_events import collect_events
from node.custody.stores.custody_store import BlockEffects, Checkpoint
from node.custody.stores.sqlite_store import SqliteStore

DATABASE_FOLDER, KEYS_FOLDER = "database", "erase-keys"
ERASED_VISITS_COUNT = 20
GRANTS_COUNT = 100


@dataclass(frozen=True, slots=True)
class Backup:
    """Simultaneous copies of a custodian's two folders."""

    database: Path
    erase_keys: Path


@dataclass(frozen=True, slots=True)
class CustodyStory:
    """Backups around the erasure, and the records erased in between.

    `grantees`: people's numbers by grant.
    """

    before: Backup
    after: Backup
    erased_ids: tuple[bytes, ...]
    grantees: dict[bytes, int]


def keep_last_day(played: Played, folder: Path) -> CustodyStory:
    view = read_ledger(played.chain.blocks)
    last = played.population.days - 1
    visits = [visit for visit in view.visits.values() if day_of(visit.at_ms) == last and visit.records]
    first_block = next(place for place, block in enumerate(played.chain.blocks) if day_of(block.time_ms) == last)
    with quiet_logs():
        asyncio.run(_follow(played, folder, first_block))
        before = _copy(folder, "before")
        chosen = visits[:: max(2, len(visits) // ERASED_VISITS_COUNT)]
        erasing_from = len(played.chain.blocks)
        grantees: dict[bytes, int] = {}
        played.run(_share(played, visits, grantees))
        played.run(_ask(played, chosen))
        asyncio.run(_follow(played, folder, erasing_from))
        after = _copy(folder, "after")
    erased = tuple(record.record_id for visit in chosen for record in visit.records)
    return CustodyStory(before, after, erased, grantees)


async def _share(played: Played, visits: Sequence[VisitSeen], grantees: dict[bytes, int]) -> None:
    numbers, chain_id = sorted(played.holders), played.chain.chain_id
    for turn in range(GRANTS_COUNT):
        visit, number = visits[turn % len(visits)], numbers[turn % len(numbers)]
        owner, grantee = played.holders[played.person_of(visit.owner)].keys, played.holders[number]
        key = derive_owner_key(owner.spend, owner.view, visit.ephemeral, chain_id=chain_id, robot=visit.robot)
        public = (grantee.keys.view.public_key, grantee.keys.spend.public_key)
        made = open_grant_keys(secrets.token_bytes(32), *public, chain_id=chain_id, owner=visit.owner)
        member_hash = hash_grant_member(secrets.token_bytes(32), grantee.handle)
        until_ms = played.chain.now_ms() + GRANT_STEP_MS * 12
        words = [[visit.records[0].record_id], made.owner, made.ephemeral, made.view_tag, member_hash, PURPOSE]
        call = played.chain.sign(key, "access", "grant", [*words, until_ms - until_ms % GRANT_STEP_MS])
        final = await played.chain.submit(call)
        if not final.ok:
            raise AssertionError(f"the chain refused a grant: {final.code}")
        grantees[call.txid] = number


async def _ask(played: Played, visits: Sequence[VisitSeen]) -> None:
    for visit in visits:
        keys = played.holders[played.person_of(visit.owner)].keys
        key = derive_owner_key(
            keys.spend, keys.view, visit.ephemeral, chain_id=played.chain.chain_id, robot=visit.robot
        )
        ids = [record.record_id for record in visit.records]
        final = await played.chain.submit(played.chain.sign(key, "erasure", "request", [ids, []]))
        if not final.ok:
            raise AssertionError(f"the chain refused an erasure: {final.code}")


async def _follow(played: Played, folder: Path, first_block: int) -> None:
    chain, now_ms = played.chain, 0
    database = folder / DATABASE_FOLDER
    database.mkdir(parents=True, exist_ok=True)
    with EraseKeys(folder / KEYS_FOLDER) as keys:
        async with SqliteStore(database) as store:
            custodian = Custodian(store, keys, member=chain.custodian.public_key, clock_ms=lambda: now_ms)
            await custodian.start()
            if await store.checkpoint() is None:
                last = chain.blocks[first_block - 1]
                await store.apply(BlockEffects(checkpoint=Checkpoint(last.height, last.block_id, last.time_ms)))
            for block in chain.blocks[first_block:]:
                now_ms = block.time_ms
                await _take(custodian, block, played)


async def _take(custodian: Custodian, block: Block, played: Played) -> None:
    for transaction in block.transactions:
        if (transaction.body.contract, transaction.body.entry) == ("records", "record"):
            await custodian.stage(played.uploads[transaction.arguments()[0]])
    events = collect_events(block.height, block.block_id, block.time_ms, block.receipts)
    await custodian.on_finalized_block(events)


def _copy(folder: Path, name: str) -> Backup:
    backup = Backup(folder / name / DATABASE_FOLDER, folder / name / KEYS_FOLDER)
    shutil.copytree(folder / DATABASE_FOLDER, backup.database)
    shutil.copytree(folder / KEYS_FOLDER, backup.erase_keys)
    return backup
