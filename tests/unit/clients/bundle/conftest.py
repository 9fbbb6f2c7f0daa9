"""One real bundle for all tests that change it: visits, pictures, a trail, an erasure, consents."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from pathlib import Path

import pytest

from clients.bundle.writing import Contents, write_bundle
from clients.wallet.export.export_building import ExportChoice, Exporter
from clients.wallet.records.viewing import RecordViewer
from consensus.chain.genesis import Genesis
from consensus.primitives.keys import PrivateKey
from tests.unit.clients.bundle.repacking import Files, list_anew, pack, sign_anew, unpack
from tests.world.ward import Ward

NOW_MS = 1_900_000_000_000


@dataclass(frozen=True)
class Made:
    """A bundle, its contents, and what its maker holds."""

    path: Path
    contents: Contents
    genesis: Genesis
    keys: dict[bytes, PrivateKey]

    @property
    def files(self) -> Files:
        return unpack(self.path)

    def forge(self, files: Files) -> bytes:
        """What the bundle's own maker, who has the keys, can make of changed files."""
        return pack(sign_anew(list_anew(files), self.genesis, lambda key: self.keys[key]))


async def collect(ward: Ward, wanted: ExportChoice | None = None, now_ms: int = NOW_MS) -> Contents:
    exporting = Exporter(ward.wallet, viewing=RecordViewer(ward.wallet, follow_max_ms=0), at_once=True)
    return await exporting.collect(await exporting.plan(wanted or ExportChoice()), now_ms)


async def make(ward: Ward, path: Path, wanted: ExportChoice | None = None) -> Contents:
    contents = await collect(ward, wanted)
    write_bundle(path, contents)
    return contents


async def make_story(ward: Ward, path: Path) -> Made:
    first, second = ward.open_visit(), ward.open_visit()
    ids = [ward.record(first), ward.record(first, frames=1), ward.record(second, frames=1)]
    ward.close_visit(first)
    await ward.erase(first, [ids[1]])
    ward.chain.must(
        ward.patient.identity, "consent", "give", ward.patient.handle, ["care"], ["rgb"], 0, 0, 0, ward.chain.height
    )
    contents = await make(ward, path)
    keys = {key: contents.find_key(key) for key in (first.owner, second.owner, ward.patient.identity.public_key)}
    return Made(path, contents, ward.genesis, keys)


@pytest.fixture
def ward(tmp_path: Path) -> Ward:
    return Ward(tmp_path)


@pytest.fixture(scope="package")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("bundle")
    return asyncio.run(make_story(Ward(folder), folder / "mine.zip"))
