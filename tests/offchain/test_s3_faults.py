"""A real S3 server with wrong keys, without its bucket, killed, and behind a proxy that refuses, cuts, or stands still."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest
from aiohttp import web
from botocore.exceptions import ClientError

from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace
from node.custody.blobs import s3_blobs
from node.custody.blobs.s3_blobs import S3Blobs
from node.custody.stores.open_store import open_store
from tests.offchain.house import CustodianHarness, refused
from tests.offchain.small_chain import record_clip
from tests.offchain.test_every_write_point import AT_MS, Story
from tests.offchain.weed import S3Server

STEPS_MAX_COUNT = 40
HOP_HEADERS = frozenset({"Transfer-Encoding", "Connection", "Content-Length"})


def house_at(place: ClipsPlace, tmp_path: Path) -> CustodianHarness:
    return CustodianHarness(lambda: open_store("sqlite", tmp_path / "custody", clips=place), tmp_path / "erase-keys")


class FaultyProxy:
    """Passes requests on to an S3 server, but for those that `fault` answers: a status, "cut" or "still"."""

    def __init__(self, server: S3Server) -> None:
        self._server = server
        self.fault: Callable[[str], int | str | None] = lambda _method: None
        self.endpoint = ""

    @asynccontextmanager
    async def open(self) -> AsyncIterator[FaultyProxy]:
        application = web.Application(client_max_size=1 << 26)
        application.router.add_route("*", "/{path:.*}", self._pass)
        runner = web.AppRunner(application, shutdown_timeout=0.1)
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", 0)
        await site.start()
        self.endpoint = "http://{}:{}".format(*runner.addresses[0][:2])
        async with aiohttp.ClientSession(auto_decompress=False) as self._session:
            try:
                yield self
            finally:
                await runner.cleanup()

    async def _pass(self, request: web.Request) -> web.StreamResponse:
        fault = self.fault(request.method)
        if isinstance(fault, int):
            return web.Response(status=fault)
        if fault == "still":
            await asyncio.sleep(60)
        async with self._session.request(
            request.method,
            f"{self._server.endpoint}{request.raw_path}",
            headers=request.headers,
            data=await request.read(),
            skip_auto_headers=("Content-Type",),
        ) as answer:
            content = await answer.read()
            headers = {name: value for name, value in answer.headers.items() if name not in HOP_HEADERS}
            if fault != "cut":
                size = answer.headers.get("Content-Length", str(len(content)))
                return web.Response(status=answer.status, body=content, headers=headers | {"Content-Length": size})
        cut = web.StreamResponse(status=answer.status, headers=headers | {"Content-Length": str(len(content))})
        await cut.prepare(request)
        await cut.write(content[: len(content) // 2])
        assert request.transport is not None
        request.transport.close()
        return cut


@pytest.fixture
async def proxy(s3_server: S3Server) -> AsyncIterator[FaultyProxy]:
    async with FaultyProxy(s3_server).open() as opened:
        yield opened


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(s3_blobs, "ANSWER_MAX_S", 0.4)


async def test_a_wrong_key_and_a_bucket_that_is_not_there_are_told_without_the_key(
    s3_server: S3Server, s3_place: ClipsPlace, tmp_path: Path
) -> None:
    wrong = s3_server.write_credentials(tmp_path / "wrong", secret_key="not-the-secret")
    for place in (replace(s3_place, credentials_path=wrong), replace(s3_place, bucket="nobodys-bucket")):
        with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE") as refusal:
            async with S3Blobs(place):
                pass
        assert "secret" not in str(refusal.value).replace("The secret key is wrong", "")


async def test_a_bucket_with_object_lock_is_refused(s3_server: S3Server, s3_place: ClipsPlace) -> None:
    client, bucket = s3_server.client(), f"{s3_place.bucket}-locked"
    client.create_bucket(Bucket=bucket, ObjectLockEnabledForBucket=True)
    with pytest.raises(BlockRobotError, match="Object Lock"):
        async with S3Blobs(replace(s3_place, bucket=bucket)):
            pass
    client.delete_bucket(Bucket=bucket)
    client.close()


async def test_two_custodians_on_one_prefix_are_refused_and_beside_each_other_they_are_not(
    s3_place: ClipsPlace, tmp_path: Path
) -> None:
    async with house_at(s3_place, tmp_path / "one").open():
        pass
    with pytest.raises(BlockRobotError, match="another custodian's"):
        async with house_at(s3_place, tmp_path / "two").open():
            pass
    async with house_at(replace(s3_place, prefix="other/"), tmp_path / "three").open():
        pass


@pytest.mark.parametrize("fault", [403, 500, 503, "cut", "still"])
async def test_a_server_that_fails_for_good_stops_the_block_and_well_again_it_is_completed(
    s3_place: ClipsPlace, proxy: FaultyProxy, tmp_path: Path, impatient: None, fault: int | str
) -> None:
    house = house_at(replace(s3_place, endpoint=proxy.endpoint), tmp_path)
    async with house.open() as custodian:
        story = Story(house)
        block = await story.prepare()
        proxy.fault = lambda method: fault if method in {"DELETE", "PUT", "GET"} else None
        await refused("STORE_UNAVAILABLE", custodian.on_finalized_block(block))
        await refused("STORE_UNAVAILABLE", custodian.export(story.kept.record_id))
        if fault != "cut":  # what answers a PUT is empty
            await refused("STORE_UNAVAILABLE", custodian.stage(record_clip(valid_until_ms=AT_MS + 9_999).upload))
        proxy.fault = lambda _method: None
        await custodian.on_finalized_block(block)
    async with house.open():  # what the refused upload left is cleared at a start
        await story.check()


async def test_some_answers_of_503_are_got_over(s3_place: ClipsPlace, proxy: FaultyProxy, tmp_path: Path) -> None:
    house, asked = house_at(replace(s3_place, endpoint=proxy.endpoint), tmp_path), [0]

    def every_third(_method: str) -> int | None:
        asked[0] += 1
        return 503 if asked[0] % 3 == 0 else None

    async with house.open() as custodian:
        proxy.fault = every_third
        story = Story(house)
        await custodian.on_finalized_block(await story.prepare())
        await story.check()
    assert asked[0] > STEPS_MAX_COUNT // 2


async def test_half_an_answer_is_a_failure_and_no_loss(
    s3_place: ClipsPlace, proxy: FaultyProxy, tmp_path: Path
) -> None:
    house = house_at(replace(s3_place, endpoint=proxy.endpoint), tmp_path)
    async with house.open() as custodian:
        clip = await house.keep()
        proxy.fault = lambda method: "cut" if method == "GET" else None
        await refused("STORE_UNAVAILABLE", custodian.export(clip.record_id))
        proxy.fault = lambda _method: None
        assert [
            frame.ciphertext for frame in (await custodian.export(clip.record_id)).frames
        ] == clip.upload.ciphertexts


async def test_a_bucket_that_somebody_deletes_stops_uploads_and_says_so(
    s3_server: S3Server, s3_place: ClipsPlace, tmp_path: Path
) -> None:
    client, bucket = s3_server.client(), f"{s3_place.bucket}-gone"
    client.create_bucket(Bucket=bucket)
    house = house_at(replace(s3_place, bucket=bucket), tmp_path)
    async with house.open() as custodian:
        kept = await house.keep()
        for page in client.get_paginator("list_objects_v2").paginate(Bucket=bucket):
            for found in page["Contents"]:
                client.delete_object(Bucket=bucket, Key=found["Key"])
        client.delete_bucket(Bucket=bucket)
        with pytest.raises(ClientError):
            client.head_bucket(Bucket=bucket)
        with pytest.raises(BlockRobotError, match="bucket is not there"):
            await custodian.stage(record_clip().upload)
        with pytest.raises(BlockRobotError, match="bucket is not there"):
            await custodian.export(kept.record_id)
    client.close()
