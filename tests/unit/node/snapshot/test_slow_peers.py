"""How long peers that send a snapshot slowly can hold a node that joins: seconds, by the clock that its tests turn."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from node.p2p.wire import SnapshotRequest
from node.snapshot import fetching, snapshot_format
from node.snapshot.fetching import SnapshotFetcher
from node.snapshot.snapshot_format import Manifest, read_manifest, write_manifest
from node.snapshot.snapshot_store import MANIFEST_INDEX
from tests.unit.node.snapshot.snapshot_peers import Answer, Peers, join, joiner_of, lying_about, make_shelves
from tests.virtual_time import in_virtual_time

pytestmark = pytest.mark.usefixtures("small_chunks")
JUST_IN_TIME_S = 4.9
"""Before a request is given up."""
PATIENCE_S = fetching.OFFER_PATIENCE_MS / 1000
TINY_COUNT = 2_000


async def started(folder: Path, *names: str) -> Peers:
    peers = Peers(folder / "peers")
    await peers.start(*names)
    await make_shelves(peers)
    return peers


async def own_manifest(peers: Peers, name: str) -> Manifest:
    return read_manifest(await peers.shelves[name].serve(encode(SnapshotRequest(b"", MANIFEST_INDEX, 0))))


def dripping(manifest: Manifest, wait: Callable[[int], float]) -> Answer:
    """A peer that offers many chunks, and sends each as one byte."""
    size = TINY_COUNT * snapshot_format.CHUNK_SIZE_MEAN_MIN_BYTES
    lie = msgspec.structs.replace(manifest, chunks=(sha256(b"x"),) * TINY_COUNT, recent_chunk_count=1, size_bytes=size)

    async def answer(request: SnapshotRequest, _own: bytes) -> bytes:
        if request.index == MANIFEST_INDEX:
            return write_manifest(lie)
        await asyncio.sleep(wait(request.index))
        return b"x"

    return answer


async def seconds_of(work: Awaitable[object]) -> float:
    loop = asyncio.get_running_loop()
    begun_s = loop.time()
    await work
    return loop.time() - begun_s


@in_virtual_time
async def test_liars_whose_chunks_come_just_in_time_hold_a_joiner_no_longer_than_its_patience(tmp_path: Path) -> None:
    """Two together outrank an honest peer; all their chunks would take forty minutes."""
    peers = await started(tmp_path, "b", "liar-1", "liar-2")
    drip = dripping(await own_manifest(peers, "b"), lambda _index: JUST_IN_TIME_S)
    peers.twisted |= {"liar-1": drip, "liar-2": drip}
    joiner, restart = joiner_of(peers, tmp_path, "b", "liar-1", "liar-2")
    assert PATIENCE_S <= await seconds_of(join(joiner, restart)) < PATIENCE_S + 10
    assert restart.is_set()
    await peers.stop()


@in_virtual_time
async def test_having_been_fast_buys_no_patience(tmp_path: Path) -> None:
    peers = await started(tmp_path, "liar")
    drip = dripping(await own_manifest(peers, "liar"), lambda index: JUST_IN_TIME_S if index > TINY_COUNT / 2 else 0)
    peers.twisted["liar"] = drip
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")

    async def fetch() -> None:
        with pytest.raises(BlockRobotError, match=r"^PEER_UNAVAILABLE: .*slowly"):
            await fetcher.fetch(["liar"], 0)

    assert await seconds_of(fetch()) <= PATIENCE_S + 1
    assert fetcher._failures == {"liar": 1}
    await peers.stop()


@in_virtual_time
async def test_what_a_slow_peer_did_send_is_not_fetched_again_from_another(tmp_path: Path) -> None:
    peers = await started(tmp_path, "b", "slow")

    async def delay(request: SnapshotRequest, answer: bytes) -> bytes:
        await asyncio.sleep(0 if request.index == MANIFEST_INDEX else 4 * JUST_IN_TIME_S)
        return answer

    peers.twisted["slow"] = delay
    fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
    with pytest.raises(BlockRobotError, match=r"^PEER_UNAVAILABLE:"):
        await fetcher.fetch(["slow"], 0)
    chunks = {index for _, index in peers.asked if index != MANIFEST_INDEX}
    peers.asked.clear()
    source = await fetcher.fetch(["slow", "b"], 0)
    total = len(read_manifest(source.manifest()).chunks)
    assert {peer for peer, index in peers.asked if index != MANIFEST_INDEX} == {"b"}
    asked = [index for _, index in peers.asked if index != MANIFEST_INDEX]
    assert fetching.CHUNKS_AT_ONCE_COUNT == total - len(asked) < len(chunks)
    await peers.stop()


@in_virtual_time
async def test_of_offers_that_are_alike_none_can_be_made_to_win(tmp_path: Path) -> None:
    peers = await started(tmp_path, "a-liar", "b")
    true = await own_manifest(peers, "b")
    peers.twisted["a-liar"] = lying_about(peers, state_row_count=true.state_row_count + 1)
    fetchers = [SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched") for _ in range(64)]
    chosen = [(await fetcher._choose(["a-liar", "b"], 0)).origin for fetcher in fetchers]
    assert set(chosen) == {"a-liar", "b"}
    await peers.stop()


@in_virtual_time
async def test_of_single_offers_one_that_would_cost_far_more_comes_last(tmp_path: Path) -> None:
    peers = await started(tmp_path, "a-liar", "b")
    true = await own_manifest(peers, "b")
    for times in range(16, 24):
        peers.twisted["a-liar"] = lying_about(peers, size_bytes=times * true.size_bytes)
        fetcher = SnapshotFetcher(peers.chain.genesis, peers, tmp_path / "fetched")
        assert (await fetcher._choose(["a-liar", "b"], 0)).origin == "b"
    await peers.stop()
