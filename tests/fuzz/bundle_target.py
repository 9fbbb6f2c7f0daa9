"""The verifier of export bundles and the reader of genesis files: what a stranger hands over as a file."""

from __future__ import annotations

import asyncio
import contextlib
import io
import tempfile
from pathlib import Path
from random import Random

import msgspec

from clients.bundle.checks.bundle_check import verify_bundle
from clients.bundle.container import BundleReader
from consensus.chain.genesis import genesis_from_json, genesis_to_json
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from tests.fuzz.target import FlipBytes, Target, refusing
from tests.fuzz.trees import change_json
from tests.unit.clients.bundle.conftest import make_story
from tests.unit.clients.bundle.repacking import Files, list_anew, pack, sign_anew
from tests.unit.node.small_nodes import make_genesis
from tests.world.ward import Ward


def open_bundle() -> Target:
    """Whole bundles; changed ones are listed and signed anew, as their maker could."""
    holder = tempfile.TemporaryDirectory(prefix="fuzz-bundle-")
    folder = Path(holder.name)
    made = asyncio.run(make_story(Ward(folder), folder / "made.zip"))
    path = folder / "input.zip"

    def run(data: bytes) -> None:
        path.write_bytes(data)
        with refusing("BUNDLE_"):
            verify_bundle(path)

    def mutate(data: bytes, random: Random, flip: FlipBytes) -> bytes:
        files = _unpack(data)
        if not files or random.random() < 0.1:
            return flip(data, random)
        name = random.choice(list(files))
        before = files[name]
        files[name] = (change_json(before, random, flip) if name.endswith(".json") else None) or flip(before, random)
        own_work = contextlib.suppress(KeyError, ValueError, msgspec.MsgspecError, BlockRobotError)
        with own_work:  # whoever has other keys leaves it unsigned
            if random.random() < 0.8:
                files = sign_anew(list_anew(files), made.genesis, lambda key: made.keys[key])
        return pack(files)

    return Target("bundle", [made.path.read_bytes()], run, mutate, 256 * 1024, holder.cleanup)


def _unpack(data: bytes) -> Files:
    try:
        reader = BundleReader(io.BytesIO(data), len(data))
        return {entry.name: reader.read(entry.name, 1 << 30) for entry in reader.entries}
    except BlockRobotError:
        return {}


def open_genesis() -> Target:
    """Genesis files, used as a node or a wallet does after reading one."""
    genesis = make_genesis(["a", "b", "c", "d"])
    text = genesis_to_json(genesis).encode()
    odd = [text.replace(b'"test"', what, 1) for what in (b'"\\ud800"', b"[[]]", b"null")]
    large = text.replace(b'"created_at_ms": ', b'"created_at_ms": 1000000000000', 1)

    def run(data: bytes) -> None:
        with refusing("GENESIS_INVALID"):
            found = genesis_from_json(data.decode("utf-8", "replace"))
            assert genesis_from_json(genesis_to_json(found)) == found
            assert len(found.chain_id) == len(found.block_id) == 32
            assert encode(found.block().header)
            assert found.schedule.quorum > 0

    def mutate(data: bytes, random: Random, flip: FlipBytes) -> bytes:
        return change_json(data, random, flip) or flip(data, random)

    return Target("genesis", [text, large, *odd], run, mutate, 32 * 1024)
