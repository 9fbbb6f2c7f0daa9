"""The stores under test: SQLite in a temporary directory, and a database on a MongoDB-compatible server."""

from __future__ import annotations

import gc
import secrets
import warnings
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit, urlunsplit

import pytest
from pymongo import MongoClient

from node.clips_place import ClipsPlace, read_place
from node.custody.stores.custody_store import CustodyStore
from node.custody.stores.open_store import open_store
from node.custody.stores.sqlite_store import SqliteStore
from tests.frozen_heap import frozen_heap
from tests.offchain import secantus, weed
from tests.offchain.house import CustodianHarness
from tests.offchain.weed import S3Server

__all__ = ["frozen_heap"]


@pytest.fixture(scope="session")
def mongo_uri() -> Iterator[str]:
    """MONGO_URI if it is set, else a server started for the tests."""
    with secantus.given_or_running() as uri:
        yield uri


@pytest.fixture
def driver_sockets() -> Iterator[None]:
    """Collect what the driver leaves behind: closed while it connects a monitor, it forgets to close that socket.

    Otherwise the warning of it would fail whatever test runs when Python finds it.
    """
    yield
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


@pytest.fixture
def mongo_database(mongo_uri: str, driver_sockets: None) -> Iterator[str]:
    """The URI of a fresh database, dropped afterwards."""
    name = f"blockrobot_test_{secrets.token_hex(6)}"
    yield urlunsplit(urlsplit(mongo_uri)._replace(path=f"/{name}"))
    with MongoClient(mongo_uri) as client:
        client.drop_database(name)


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    """The server of S3_ENDPOINT if it is set, else one started for the tests."""
    with weed.given_or_running() as server:
        yield server


@pytest.fixture
def s3_place(s3_server: S3Server, tmp_path: Path) -> Iterator[ClipsPlace]:
    """An empty bucket, removed afterwards, and a file of credentials."""
    bucket, client = f"blockrobot-test-{secrets.token_hex(6)}", s3_server.client()
    client.create_bucket(Bucket=bucket)
    credentials = s3_server.write_credentials(tmp_path / "credentials")
    yield read_place(f"s3://{bucket}/ward", tmp_path, endpoint=s3_server.endpoint, credentials_path=credentials)
    for page in client.get_paginator("list_objects_v2").paginate(Bucket=bucket):
        for found in page.get("Contents", ()):
            client.delete_object(Bucket=bucket, Key=found["Key"])
    client.delete_bucket(Bucket=bucket)
    client.close()


@pytest.fixture(params=["sqlite", "sqlite+folder", "sqlite+s3", "mongo", "mongo+s3"])
def make_store(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], CustodyStore]:
    """A maker of stores over one and the same database: a second one sees what the first left."""
    if request.param == "sqlite":
        return lambda: SqliteStore(tmp_path / "custody")
    index, _, clips = request.param.partition("+")
    uri = "sqlite" if index == "sqlite" else request.getfixturevalue("mongo_database")
    place = request.getfixturevalue("s3_place") if clips == "s3" else None
    if clips == "folder":
        place = read_place("folder:blobs", tmp_path)
    return lambda: open_store(uri, tmp_path / "custody", clips=place)


@pytest.fixture
async def store(make_store: Callable[[], CustodyStore]) -> AsyncIterator[CustodyStore]:
    """One open store of each kind."""
    async with make_store() as opened:
        yield opened


@pytest.fixture
def house(make_store: Callable[[], CustodyStore], tmp_path: Path) -> CustodianHarness:
    return CustodianHarness(make_store, tmp_path / "erase-keys")


@pytest.fixture
async def opened(house: CustodianHarness) -> AsyncIterator[CustodianHarness]:
    async with house.open():
        yield house
