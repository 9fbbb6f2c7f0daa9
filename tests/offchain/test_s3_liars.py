"""S3 servers that answer without an end, what was not asked for, or in no form; and what a file of credentials may say."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import pytest
from aiohttp import web

from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace, read_place
from node.custody.blobs import blob_backed_store, s3_blobs
from node.custody.blobs.blob_names import BlobNames
from node.custody.blobs.s3_blobs import ANSWER_MAX_BYTES, S3Blobs
from node.custody.stores.open_store import open_store
from node.custody.stores.sqlite_store import SqliteStore

MIB = 1 << 20
ENDLESS_MAX_MIB = 64
RECORD = b"r" * 16
Answer = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Liar:
    """An empty bucket, but for the questions that `lies` answers: "lock", "list", "get", "put"."""

    def __init__(self) -> None:
        self.lies: dict[str, Answer] = {}
        self.asked: list[str] = []
        self.sent_mib = 0
        self.endpoint = ""

    async def answer(self, request: web.Request) -> web.StreamResponse:
        self.asked.append(f"{request.method} {request.raw_path}")
        names = {"object-lock": "lock", "list-type": "list", "versioning": "versioning"}
        question = next((name for part, name in names.items() if part in request.query), request.method.lower())
        if lie := self.lies.get(question):
            return await lie(request)
        if question == "get":
            return web.Response(status=404, text="<Error><Code>NoSuchKey</Code></Error>")
        root = "VersioningConfiguration" if question == "versioning" else "ListBucketResult"
        return web.Response(text=f"<{root}/>" if request.method == "GET" else "")

    async def endless(self, request: web.Request) -> web.StreamResponse:
        answer = web.StreamResponse()
        answer.enable_chunked_encoding()
        await answer.prepare(request)
        with suppress(ConnectionError):
            while self.sent_mib < ENDLESS_MAX_MIB:
                await answer.write(b" " * MIB)
                self.sent_mib += 1
        return answer


@pytest.fixture
async def liar() -> AsyncIterator[Liar]:
    liar = Liar()
    application = web.Application()
    application.router.add_route("*", "/{path:.*}", liar.answer)
    runner = web.AppRunner(application, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    liar.endpoint = "http://{}:{}".format(*runner.addresses[0][:2])
    yield liar
    await runner.cleanup()


def credentials(tmp_path: Path, more: str = "") -> Path:
    path = tmp_path / "credentials"
    path.write_text(f"[default]\naws_access_key_id = one\naws_secret_access_key = two\n{more}")
    return path


@pytest.fixture
def place(liar: Liar, tmp_path: Path) -> ClipsPlace:
    return read_place("s3://clips/ward", tmp_path, endpoint=liar.endpoint, credentials_path=credentials(tmp_path))


def saying(text: str, status: int = 200) -> Answer:
    async def answer(_request: web.Request) -> web.Response:
        return web.Response(text=text, status=status)

    return answer


async def refused(work: Awaitable[object], why: str = "") -> None:
    with pytest.raises(BlockRobotError, match=f"^STORE_UNAVAILABLE.*{why}"):
        await work


async def names_of(blobs: S3Blobs, prefix: str = "") -> list[str]:
    return [name async for name in blobs.names(prefix)]


async def test_an_answer_without_an_end_is_not_read_to_its_end(liar: Liar, place: ClipsPlace) -> None:
    async def refusal(_request: web.Request) -> web.StreamResponse:
        return web.Response(status=400, body=b"<Error><Code>" + b"x" * 2 * ANSWER_MAX_BYTES)

    async with S3Blobs(place) as blobs:
        liar.lies |= dict.fromkeys(("lock", "list", "get", "put"), liar.endless)
        for work in (blobs._require_erasable(), names_of(blobs), blobs.get("one", MIB), blobs.put("one", b"1")):
            await refused(work)
            assert liar.sent_mib < ENDLESS_MAX_MIB
            liar.sent_mib = 0
        liar.lies["get"] = refusal
        await refused(blobs.get("one", MIB), "too long")


async def test_a_blob_has_the_length_that_was_said_and_no_more_than_was_asked_for(
    liar: Liar, place: ClipsPlace
) -> None:
    async def without_length(request: web.Request) -> web.StreamResponse:
        answer = web.StreamResponse()
        answer.enable_chunked_encoding()
        await answer.prepare(request)
        await answer.write(b"hello")
        return answer

    async with S3Blobs(place) as blobs:
        liar.lies["get"] = without_length
        await refused(blobs.get("one", 10))
        liar.lies["get"] = saying("hello")
        assert await blobs.get("one", 5) == b"hello"
        assert await blobs.get("one", 4) is None


async def test_an_answer_that_drips_ends_after_a_time(
    liar: Liar, place: ClipsPlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def drip(request: web.Request) -> web.StreamResponse:
        answer = web.StreamResponse()
        answer.content_length = MIB
        await answer.prepare(request)
        with suppress(ConnectionError):
            while True:
                await answer.write(b" ")
                await asyncio.sleep(0.05)
        return answer

    async with S3Blobs(place) as blobs:
        monkeypatch.setattr(s3_blobs, "CALL_MAX_S", 0.5)
        liar.lies |= dict.fromkeys(("list", "get"), drip)
        for work in (names_of(blobs), blobs.get("one", MIB)):
            await refused(work, "TimeoutError")


def page(*keys: str, then: str = "") -> str:
    contents = "".join(f"<Contents><Key>{key}</Key></Contents>" for key in keys)
    more = f"<IsTruncated>true</IsTruncated><NextContinuationToken>{then}</NextContinuationToken>" if then else ""
    return f"<ListBucketResult>{contents}{more}</ListBucketResult>"


async def test_a_list_of_keys_has_an_end_and_all_its_pages(
    liar: Liar, place: ClipsPlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with S3Blobs(place) as blobs:

        async def last(request: web.Request) -> web.Response:
            is_second = request.query.get("continuation-token") == "t"
            return web.Response(text=page("ward/two") if is_second else page("ward/one", then="t"))

        liar.lies["list"] = last
        assert await names_of(blobs) == ["one", "two"]
        liar.lies["list"] = saying(page("ward/one", then="t"))
        await refused(names_of(blobs), "no end")
        monkeypatch.setattr(s3_blobs, "LISTING_MAX_S", 0.0)
        await refused(names_of(blobs), "TimeoutError")


def counting(pages_count: int) -> Answer:
    """So many pages of one key each, and after the last one the first again."""

    async def answer(request: web.Request) -> web.Response:
        at = int(request.query.get("continuation-token", "0"))
        return web.Response(text=page(f"ward/{at:06}", then=str((at + 1) % pages_count)))

    return answer


async def test_a_list_may_have_any_number_of_pages_but_none_twice_and_that_of_one_clip_few(
    liar: Liar, place: ClipsPlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(s3_blobs, "PAGES_OF_A_CLIP_MAX_COUNT", 5)
    async with S3Blobs(place) as blobs:
        for pages_count in (1, 2, 7):
            liar.lies["list"], liar.asked = counting(pages_count), []
            await refused(names_of(blobs), "no end")
            assert len(liar.asked) <= 4 * pages_count
        liar.lies["list"], liar.asked = counting(1_000), []
        await refused(names_of(blobs, "0"), "one clip's")
        assert len(liar.asked) == 5

        async def long(request: web.Request) -> web.Response:
            at = int(request.query.get("continuation-token", "0"))
            return web.Response(text=page(f"ward/{at:06}", then=str(at + 1) if at < 99 else ""))

        liar.lies["list"] = long
        assert len(await names_of(blobs)) == 100


async def test_of_one_clips_blobs_there_is_an_end_and_no_other_name_is_deleted(
    liar: Liar, place: ClipsPlace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names, other = BlobNames(b"k" * 32), BlobNames(b"o" * 32)
    wanted = [names.name(RECORD, number.to_bytes(8)) for number in range(8)]
    async with S3Blobs(place) as blobs:
        store = blob_backed_store.BlobBackedStore(SqliteStore(tmp_path / "custody"), blobs, names, tmp_path)
        prefix = names.prefix(RECORD)
        pages = iter((page(f"ward/{prefix}notes", f"ward/{wanted[0]}"), page(f"ward/{prefix}notes")))

        async def until_deleted(_request: web.Request) -> web.Response:
            return web.Response(text=next(pages))

        liar.lies["list"] = until_deleted
        await store._delete_all(RECORD)
        deleted = [line for line in liar.asked if line.startswith("DELETE")]
        assert [line.partition("?")[0] for line in deleted] == [f"DELETE /clips/ward/{wanted[0]}"]
        liar.lies["list"] = saying(page(f"ward/{other.name(RECORD, bytes(8))}"))
        await refused(store._delete_all(RECORD), "not asked for")
        assert [line for line in liar.asked if line.startswith("DELETE")] == deleted
        liar.lies["list"] = saying(page(*(f"ward/{name}" for name in wanted)))
        await refused(store._delete_all(RECORD), "after it was deleted")
        monkeypatch.setattr(blob_backed_store, "LISTS_MAX_COUNT", 3)
        numbers = itertools.count(100)

        async def always_new(_request: web.Request) -> web.Response:
            return web.Response(text=page(f"ward/{names.name(RECORD, next(numbers).to_bytes(8))}"))

        liar.lies["list"] = always_new
        await refused(store._delete_all(RECORD), "without an end")
        assert next(numbers) == 103


async def test_an_answer_of_the_wrong_form_is_a_failure_of_the_server(liar: Liar, place: ClipsPlace) -> None:
    async with S3Blobs(place) as blobs:
        for text in (
            "no XML",
            page("elsewhere/one"),
            "<ListBucketResult><Contents/></ListBucketResult>",
            "<ListBucketResult><IsTruncated>true</IsTruncated></ListBucketResult>",
            "<ListBucketResult><Contents><Key>ward/1</Key><Size>x</Size></Contents></ListBucketResult>",
        ):
            liar.lies["list"] = saying(text)
            await refused(names_of(blobs))
        liar.lies["get"] = saying("<a>" * 100_000 + "</a>" * 100_000, 400)
        await refused(blobs.get("one", MIB))
        liar.lies["get"] = saying(f"<Error><Code>{'x' * 100} wrong&#10;line</Code></Error>", 400)
        await refused(blobs.get("one", MIB), r": The S3 server refuses with an error\.$")


async def test_of_a_page_of_names_the_times_are_not_read(liar: Liar, place: ClipsPlace) -> None:
    """That took most of what a page takes, while a node did nothing else."""
    contents = "<Contents><Key>ward/one</Key><LastModified>when?</LastModified></Contents>"
    async with S3Blobs(place) as blobs:
        liar.lies["list"] = saying(f"<ListBucketResult>{contents}</ListBucketResult>")
        assert await names_of(blobs) == ["one"]


async def test_a_redirect_leads_nowhere(liar: Liar, place: ClipsPlace) -> None:
    async def elsewhere(request: web.Request) -> web.Response:
        return web.Response(status=307, headers={"Location": "/elsewhere"})

    async with S3Blobs(place) as blobs:
        liar.lies |= dict.fromkeys(("get", "put", "list"), elsewhere)
        for work in (blobs.get("one", MIB), blobs.put("one", b"1"), names_of(blobs)):
            await refused(work)
    assert not [line for line in liar.asked if "elsewhere" in line]


async def test_a_file_of_credentials_gives_two_keys_and_runs_nothing(
    liar: Liar, place: ClipsPlace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name, raising=False)
    program = f"credential_process = /usr/bin/touch {tmp_path / 'ran'}\n"
    credentials(tmp_path, program)
    async with S3Blobs(place) as blobs:
        assert await blobs.get("one", MIB) is None
    for text in (f"[default]\n{program}", f"[other]\n{program}", program, "[default]\naws_secret_access_key = two\n"):
        (tmp_path / "credentials").write_text(text)
        with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID.*under \[default\]") as refusal:
            async with S3Blobs(place):
                pass
        assert "touch" not in str(refusal.value)
        assert "two" not in str(refusal.value)
    (tmp_path / "credentials").unlink()
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID.*No such file"):
        async with S3Blobs(place):
            pass
    assert not (tmp_path / "ran").exists()


async def test_a_session_token_goes_with_the_keys_and_nothing_of_this_machine(
    liar: Liar, place: ClipsPlace, tmp_path: Path
) -> None:
    credentials(tmp_path, "aws_session_token = three\n")
    given = []

    async def answer(request: web.Request) -> web.Response:
        names = ("Authorization", "X-Amz-Security-Token", "User-Agent")
        given.append(tuple(request.headers[name].partition("/")[0] for name in names))
        return web.Response(text="" if request.method == "PUT" else page())

    async with S3Blobs(place) as blobs:
        liar.lies |= dict.fromkeys(("list", "put", "get"), answer)
        assert await names_of(blobs) == []
        await blobs.put("one", b"1")
        assert await blobs.get("one", MIB)
    assert given == [("AWS4-HMAC-SHA256 Credential=one", "three", "blockrobot")] * 3


async def test_no_blob_waits_until_the_server_has_asked_for_its_content(liar: Liar, place: ClipsPlace) -> None:
    waits: list[bool] = []

    async def answer(request: web.Request) -> web.Response:
        waits.append("Expect" in request.headers)
        return web.Response()

    async with S3Blobs(place) as blobs:
        liar.lies["put"] = answer
        await blobs.put("one", b"1")
    assert waits == [False]


async def test_a_folder_that_is_anothers_loses_nothing(tmp_path: Path) -> None:
    """Unfinished files are deleted where blobs are, and once the folder is this custodian's."""
    folder = tmp_path / "blobs"
    left = [
        folder / name for name in ("ab/cd/.unfinished-1", ".unfinished-2", "notes/.unfinished-3", "ab/.unfinished-4")
    ]
    for path in left:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    (folder / "custodian").write_text("another's")
    place = read_place("folder:blobs", tmp_path)
    with pytest.raises(BlockRobotError, match="another custodian's"):
        async with open_store("sqlite", tmp_path / "custody", clips=place):
            pass
    assert [path.exists() for path in left] == [True] * 4
    (folder / "custodian").unlink()
    async with open_store("sqlite", tmp_path / "custody", clips=place):
        pass
    assert [path.exists() for path in left] == [False, True, True, True]
