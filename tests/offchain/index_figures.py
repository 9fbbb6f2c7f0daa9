"""What each query of the MongoDB store costs beside how many rows, by which index, and how many shards it would ask.

Run it from the root of the repository, where the tests run: .venv/bin/python -m tests.offchain.index_figures 10000 100000
"""

from __future__ import annotations

import asyncio
import hashlib
import itertools
import re
import secrets
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from statistics import median
from urllib.parse import urlsplit, urlunsplit

from pymongo import MongoClient
from pymongo.database import Database

from consensus.errors import BlockRobotError
from node.custody.stores import mongo_documents as documents
from node.custody.stores.custody_store import Grant, OutboxRow, RecordFacts
from node.custody.stores.mongo_documents import Document
from node.custody.stores.mongo_store import MongoStore
from tests.offchain import secantus
from tests.offchain.recorded_commands import recorded_commands
from tests.offchain.stored_clips import make_clip
from tests.offchain.test_mongo_store import OWNER, QUERIES, RECORD_ID, TXID

Make = Callable[[int, bytes, bytes], Document]

INSERTED_AT_ONCE_COUNT = 1_000
RUNS_COUNT = 5
FAR_MS = 1_800_000_000_000
SHARDS_COUNT = 8
FRAME_BYTES = 100
WALKS = {"all_clips", "slots_in_use", "records_with_frames", "stage_all"}
"""Left out: what reads all rows by its nature, and what only writes."""
SHARD_KEYS: Mapping[str, Mapping[str, str]] = {
    "clips": {"record id": "_id", "owner": "owner", "expiry": "expires_at_ms"},
    "frames": {"record id": "record_id"},
}


def _clip(number: int, record_id: bytes, owner: bytes) -> Document:
    found = documents.clip_document(make_clip(number, 1, 5)[0])
    status = ("staged", "erased", *["confirmed"] * 18)[number % 20]
    far_ms = FAR_MS + number
    told = {"expires_at_ms": far_ms, "valid_until_ms": far_ms, "robot": owner[:3] * 11, "height": number}
    return {**found, **told, "_id": record_id, "owner": owner, "status": status}


def _frame(number: int, record_id: bytes, _owner: bytes) -> Document:
    frame = make_clip(number, FRAME_BYTES, 1)[1][0]
    return {**documents.frame_document(frame), "_id": record_id + bytes(4), "record_id": record_id, "slot": number}


def _missing(number: int, record_id: bytes, owner: bytes) -> Document:
    facts = RecordFacts(record_id, TXID, owner, TXID, TXID, FAR_MS + number, number)
    return documents.missing_document(facts)


def _grant(number: int, record_id: bytes, owner: bytes) -> Document:
    return documents.grant_document(Grant(record_id * 2, owner, (record_id,), number))


def _outbox(number: int, record_id: bytes, _owner: bytes) -> Document:
    row = OutboxRow("access.released", record_id * 2, 0, "access", "released", bytes(60), number)
    return {"_id": documents.outbox_id(row.key), **documents.outbox_document(row)}


def _share(number: int, record_id: bytes, owner: bytes) -> Document:
    told = {"owner": owner, "records": [record_id], "until_ms": FAR_MS + number, "height": number}
    return {"_id": record_id * 2, **told}


def _part(number: int, record_id: bytes, owner: bytes) -> Document:
    names = {"_id": record_id * 3, "grant_id": record_id * 2, "record_id": record_id, "owner": owner}
    told = {"valid_until_ms": FAR_MS, "status": "confirmed", "height": number, "slot": number, "wrapped": bytes(200)}
    return names | told


ROWS: Mapping[str, Make] = {
    "clips": _clip,
    "frames": _frame,
    "missing": _missing,
    "grants": _grant,
    "outbox": _outbox,
    "shares": _share,
    "parts": _part,
}


def _fill(database: Database[Document], first: int, count: int) -> dict[str, float]:
    """Rows a second; five clips a visit, as of one whom a robot met once."""
    speeds = {}
    for name, make in ROWS.items():
        begun_s = time.perf_counter()
        dice = iter([secrets.token_bytes(33) for _ in range(count // 5 + 1)])
        owners = itertools.chain.from_iterable(itertools.repeat(owner, 5) for owner in dice)
        made: Iterator[Document] = (
            make(number, secrets.token_bytes(16), owner)
            for number, owner in zip(range(first, first + count), owners, strict=False)
        )
        while some := list(itertools.islice(made, INSERTED_AT_ONCE_COUNT)):
            database[name].insert_many(some)
        speeds[name] = count / (time.perf_counter() - begun_s)
    return speeds


def _put_what_is_asked_for(database: Database[Document]) -> None:
    for name, make in ROWS.items():
        row = make(2, RECORD_ID, OWNER)
        row = row | {"_id": RECORD_ID if name in {"clips", "missing"} else row["_id"]}
        database[name].replace_one({"_id": row["_id"]}, row, upsert=True)


def _indexes(plan: object) -> str:
    found = re.findall(r"'indexName': '([^']+)'", str(plan))
    stages = set(re.findall(r"'stage': '(\w+)'", str(plan)))
    return ", ".join(dict.fromkeys(found)) or "/".join(sorted(stages & {"IDHACK", "COLLSCAN", "EOF"}))


def _index_of(database: Database[Document], name: str, where: Document) -> str:
    """As the server explains it; ranges of the primary key, which the test server calls a scan, by their name."""
    if set(where) <= {"_id"} or isinstance(where.get("_id"), (bytes, str, dict)):
        return "_id"
    return _indexes(database.command("explain", {"find": name, "filter": where}, verbosity="queryPlanner"))


def _asks(name: str, where: Document) -> str:
    """By shard key: one shard, those of what is named, or all."""
    told = []
    for label, field in SHARD_KEYS.get(name, {}).items():
        value = where.get(field)
        is_set = isinstance(value, dict) and "$in" in value
        told.append(f"{label} {'its' if is_set else 'one' if isinstance(value, bytes) else 'all'}")
    return ", ".join(told) or "not sharded"


async def _measure(uri: str, database: Database[Document]) -> dict[tuple[str, str, str], tuple[str, float]]:
    """Of each query and each of its commands: the index, and the median of its times in ms."""
    took: dict[tuple[str, str, str], list[float]] = {}
    found: dict[tuple[str, str, str], str] = {}
    with recorded_commands() as commands:
        async with MongoStore(uri) as store:
            for query in sorted(QUERIES.keys() - WALKS):
                for _ in range(RUNS_COUNT):
                    _put_what_is_asked_for(database)
                    commands.sent.clear()
                    with suppress(BlockRobotError):  # a server that did not answer in time: no figure
                        await QUERIES[query](store)
                    for command in [command for command in commands.sent if command.took_ms]:
                        for where in command.filters[:1]:
                            key = (query, f"{command.kind} {command.collection}", _asks(command.collection, where))
                            took.setdefault(key, []).append(command.took_ms)
                            found[key] = found.get(key) or _index_of(database, command.collection, where)
    return {key: (found[key], median(times)) for key, times in took.items()}


def _spread(count: int) -> float:
    """The fullest of the shards, beside their mean, of so many random record ids in a hashed index."""
    placed = Counter(hashlib.md5(secrets.token_bytes(16)).digest()[0] % SHARDS_COUNT for _ in range(count))
    return max(placed.values()) * SHARDS_COUNT / count


def main() -> None:
    """Print a table of all queries, and how fast rows went in."""
    sizes = sorted(int(size) for size in sys.argv[1:]) or [10_000]
    columns = []
    with secantus.given_or_running() as server:
        uri = urlunsplit(urlsplit(server)._replace(path=f"/blockrobot_figures_{secrets.token_hex(4)}"))
        with MongoClient[Document](uri) as client:
            database = client.get_default_database()
            asyncio.run(_open_once(uri))
            for before, size in itertools.pairwise([0, *sizes]):
                speeds = _fill(database, before, size - before)
                print(f"{size} rows each, filled at rows/s: " + ", ".join(f"{n} {v:.0f}" for n, v in speeds.items()))  # noqa: T201
                columns.append(asyncio.run(_measure(uri, database)))
            client.drop_database(database.name)
    spread = f"fullest of {SHARDS_COUNT} shards {_spread(max(sizes)):.3f} of the mean"
    print(f"{max(sizes)} record ids: {spread}")  # noqa: T201
    print(f"| query | command | index | shards, by shard key | {' | '.join(f'ms at {size}' for size in sizes)} |")  # noqa: T201
    print("|---" * (4 + len(sizes)) + "|")  # noqa: T201
    for key in sorted(columns[-1]):
        times = [f"{column[key][1]:.1f}" if key in column else "" for column in columns]
        print("| " + " | ".join([key[0], key[1], columns[-1][key][0], key[2], *times]) + " |")  # noqa: T201


async def _open_once(uri: str) -> None:
    async with MongoStore(uri):
        pass


if __name__ == "__main__":
    main()
