"""A cluster of S3 servers of which one and then the leading one is killed, under uploads and under erasures."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from node.clips_place import read_place
from node.custody.stores.open_store import open_store
from tests.offchain.house import CustodianHarness, refused
from tests.offchain.small_chain import EXPIRES_MS, RecordedClip, erasure, record_clip, recorded
from tests.offchain.weed import Cluster

AWAY_MAX_S = 90.0
pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with Cluster(tmp_path) as cluster:
        yield cluster


async def in_the_end(work: Callable[[], Awaitable[object]]) -> None:
    """As robots and the hook do: again, until the store answers."""
    deadline = time.monotonic() + AWAY_MAX_S
    while True:
        try:
            await work()
            return
        except BlockRobotError as error:
            if error.code != "STORE_UNAVAILABLE" or time.monotonic() > deadline:
                raise
        await asyncio.sleep(0.2)


async def test_servers_are_killed_and_no_clip_is_lost_or_kept(cluster: Cluster, tmp_path: Path) -> None:
    bucket, client = f"blockrobot-test-{secrets.token_hex(6)}", cluster.server.client()
    client.create_bucket(Bucket=bucket)
    client.close()
    credentials = cluster.server.write_credentials(tmp_path / "credentials")
    place = read_place(f"s3://{bucket}", tmp_path, endpoint=cluster.server.endpoint, credentials_path=credentials)
    house = CustodianHarness(lambda: open_store("sqlite", tmp_path / "custody", clips=place), tmp_path / "erase-keys")
    clips: list[RecordedClip] = []
    gone: list[RecordedClip] = []
    async with house.open() as custodian:

        async def work_on(count: int) -> None:
            """Of four clips that are recorded, one is erased again."""
            for number in range(count):
                clip = record_clip()
                await in_the_end(lambda clip=clip: custodian.stage(clip.upload))
                await follow(recorded(clip, expires_at_ms=EXPIRES_MS + 9_999_999))
                clips.append(clip)
                if number % 4 == 3:
                    gone.append(clips[-2])
                    await follow(erasure(secrets.token_bytes(32), clips[-2]))

        async def follow(event: tuple) -> None:
            block = house.chain.block(event)
            await in_the_end(lambda: custodian.on_finalized_block(block))

        await work_on(8)
        cluster.kill("volume-0")
        await work_on(16)
        cluster.kill(cluster.leading_master())
        await work_on(16)
        cluster.start("volume-0")
        await work_on(8)
        for clip in clips:
            if clip in gone:
                await refused("CLIP_ERASED", custodian.export(clip.record_id))
            else:
                found = await custodian.export(clip.record_id)
                assert [frame.ciphertext for frame in found.frames] == clip.upload.ciphertexts
    assert (len(clips), len(gone)) == (48, 12)
