"""A custodian's upkeep is for its operator alone: everybody else is tried at each route, and nothing is done for them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer, make_mocked_request

from consensus.errors import BlockRobotError
from network.custody.custody_requests import LINE_TIMEOUT_S, ask_status, run_work
from node.config import NodeConfig
from node.custody.coordination.custody_admin import describe_rebuild, describe_scrub
from node.custody.coordination.custody_admin_routes import HEARTBEAT_S
from node.custody.coordination.custody_answers import (
    CustodyStatus,
    MissingReceipts,
    OverdueErasure,
    Progress,
    RebuildAnswer,
    ScrubAnswer,
)
from node.custody.repair.rebuild import RebuildReport
from node.custody.repair.scrub import ScrubReport
from node.faults import TOKEN_FILE_NAME
from node.operator_listener import create_operator_listener

pytestmark = pytest.mark.smoke

TOKEN = "5e" * 32
RECORD = b"r" * 16
ROUTES = [("GET", "/custody"), ("POST", "/custody/scrub"), ("POST", "/custody/rebuild")]


SCRUBBED = describe_scrub(ScrubReport(height=7, corrupted=[(b"r" * 16, 3)]))
REBUILT = describe_rebuild(RebuildReport(height=7, mended=[b"r" * 16]))
STATUS = CustodyStatus(
    uploads=[],
    quotas={},
    bytes_a_day=0,
    disk_free_bytes=None,
    disk_reserve_bytes=None,
    uploads_paused=False,
    days_until_reserve=None,
    name="node-1",
    member="02" * 33,
    checkpoint_height=7,
    finalized_height=7,
    behind_blocks=0,
    custodian=True,
    failing=[],
    serving=True,
    busy=False,
    clips_held=1,
    clips_staged=0,
    clips_missing=0,
    clips_erased=0,
    frames=4,
    shares=0,
    key_parts=0,
    outbox_ready=1,
    outbox_erasing=0,
    slots_used=4,
    slots_total=64,
    store_bytes=None,
    waiting_for={"03" * 33: MissingReceipts(1, [OverdueErasure("ab" * 32, 900, 3)])},
)


class Status:
    def is_ready(self) -> bool:
        return True

    def problem(self) -> None:
        return None

    def describe(self) -> Mapping[str, Any]:
        return {}

    def metrics(self) -> bytes:
        return b""


class ScriptedUpkeep:
    """Notes what is asked of it; fails as the test says."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.failure: Exception | None = None
        self.may_end = asyncio.Event()
        self.may_end.set()

    async def status(self) -> CustodyStatus:
        self._note("status")
        return STATUS

    async def scrub(self, tell: Any, after: bytes) -> ScrubAnswer:
        tell("records", 5, 0, RECORD)
        await self.may_end.wait()
        self._note(f"scrub {after.hex()}".rstrip())
        return SCRUBBED

    async def rebuild(self, tell: Any) -> RebuildAnswer:
        await self.may_end.wait()
        self._note("rebuild")
        return REBUILT

    def _note(self, what: str) -> None:
        self.asked.append(what)
        if self.failure is not None:
            raise self.failure


@pytest.fixture
def upkeep() -> ScriptedUpkeep:
    return ScriptedUpkeep()


@pytest.fixture
async def server(upkeep: ScriptedUpkeep) -> AsyncIterator[TestServer]:
    application = create_operator_listener(Status(), None, TOKEN, upkeep)  # type: ignore[arg-type]
    async with TestServer(application, host="127.0.0.1") as running:
        yield running


@pytest.fixture
def config(server: TestServer, tmp_path: Path) -> NodeConfig:
    """What a command knows of the node: its folder with the token, and its operator's port."""
    (tmp_path / TOKEN_FILE_NAME).write_text(TOKEN)
    names = {name: tmp_path / name for name in ("genesis_path", "tls_certificate_path", "tls_key_path")}
    ports = {"p2p_port": 1, "api_port": 2, "operator_port": server.port or 0}
    keys = {"producer_key_path": None, "custodian_key_path": tmp_path / "key"}
    plain = {"name": "node-1", "host": "127.0.0.1", "custody_store": "sqlite", "log_level": "info"}
    return NodeConfig(data_dir=tmp_path, **names, **ports, **keys, **plain)  # type: ignore[arg-type]


@pytest.mark.parametrize(("method", "path"), ROUTES)
@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Authorization": "Bearer "},
        {"Authorization": f"Bearer {'0' * 64}"},
        {"Authorization": TOKEN},
        {"Authorization": f"Bearer {TOKEN}", "Origin": "http://127.0.0.1"},
    ],
    ids=["none", "empty", "wrong", "bare", "web page"],
)
async def test_nobody_without_the_operators_token_is_answered(
    server: TestServer, upkeep: ScriptedUpkeep, method: str, path: str, headers: dict[str, str]
) -> None:
    async with (
        aiohttp.ClientSession() as session,
        session.request(method, server.make_url(path), headers=headers) as response,
    ):
        assert response.status in {401, 403}
        assert (await response.json())["code"] in {"OPERATOR_TOKEN_INVALID", "NOT_PERMITTED"}
    assert upkeep.asked == []


@pytest.mark.parametrize(("method", "path"), ROUTES)
async def test_another_machine_is_not_answered_even_with_the_token(
    upkeep: ScriptedUpkeep, method: str, path: str
) -> None:
    application = create_operator_listener(Status(), None, TOKEN, upkeep)  # type: ignore[arg-type]
    headers = {"Authorization": f"Bearer {TOKEN}"}
    request = make_mocked_request(method, path, headers=headers, app=application).clone(remote="10.0.0.7")
    response = await (await application.router.resolve(request)).handler(request)
    assert isinstance(response, web.Response)
    assert isinstance(response.body, bytes)
    assert json.loads(response.body)["code"] == "NOT_PERMITTED"
    assert upkeep.asked == []


async def test_work_is_not_begun_by_looking(server: TestServer, upkeep: ScriptedUpkeep) -> None:
    headers = {"Authorization": f"Bearer {TOKEN}"}
    async with aiohttp.ClientSession(headers=headers) as session:
        for path in ("/custody/scrub", "/custody/rebuild"):
            async with session.get(server.make_url(path)) as response:
                assert response.status == 405
    assert upkeep.asked == []


async def test_a_node_without_a_token_or_without_clips_refuses(upkeep: ScriptedUpkeep) -> None:
    for token, kept, code in (("", upkeep, "OPERATOR_TOKEN_INVALID"), (TOKEN, None, "CUSTODY_ELSEWHERE")):
        application = create_operator_listener(Status(), None, token, kept)  # type: ignore[arg-type]
        headers = {"Authorization": f"Bearer {token}"}
        request = make_mocked_request("GET", "/custody", headers=headers, app=application).clone(remote="127.0.0.1")
        response = await (await application.router.resolve(request)).handler(request)
        assert isinstance(response, web.Response)
        assert isinstance(response.body, bytes)
        assert json.loads(response.body)["code"] == code
    assert upkeep.asked == []


async def test_the_command_asks_with_the_token_of_the_data_directory(
    config: NodeConfig, upkeep: ScriptedUpkeep
) -> None:
    assert await ask_status(config) == STATUS
    assert await run_work(config, ScrubAnswer, lambda *_: None) == SCRUBBED
    assert await run_work(config, ScrubAnswer, lambda *_: None, after=RECORD) == SCRUBBED
    assert await run_work(config, RebuildAnswer, lambda *_: None) == REBUILT
    assert upkeep.asked == ["status", "scrub", f"scrub {RECORD.hex()}", "rebuild"]


async def test_a_scrub_tells_after_which_record_another_could_go_on(
    config: NodeConfig, upkeep: ScriptedUpkeep, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("node.custody.coordination.custody_admin_routes.TELL_EVERY_S", 0.001)
    upkeep.may_end.clear()
    heard: list[tuple[str, Progress]] = []

    def hear(name: str, progress: Progress) -> None:
        heard.append((name, progress))
        upkeep.may_end.set()

    await run_work(config, ScrubAnswer, hear)
    assert heard == [("node-1", Progress(what="records", done=5, total=0, last=RECORD.hex()))]


@pytest.mark.parametrize("after", ["zz", "72", "72" * 17])
async def test_a_scrub_after_what_is_no_record_is_refused(
    server: TestServer, upkeep: ScriptedUpkeep, after: str
) -> None:
    async with (
        aiohttp.ClientSession(headers={"Authorization": f"Bearer {TOKEN}"}) as session,
        session.post(server.make_url("/custody/scrub"), params={"after": after}) as response,
    ):
        assert (response.status, (await response.json())["code"]) == (400, "REQUEST_INVALID")
    assert upkeep.asked == []


async def test_work_that_has_nothing_to_say_for_long_is_still_heard_of(
    config: NodeConfig, upkeep: ScriptedUpkeep, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever hears nothing hangs up, and work that nobody waits for is given up."""
    monkeypatch.setattr("node.custody.coordination.custody_admin_routes.TELL_EVERY_S", 0.001)
    monkeypatch.setattr("node.custody.coordination.custody_admin_routes.HEARTBEAT_S", 0.0)
    upkeep.may_end.clear()
    heard: list[str] = []

    def hear(_name: str, progress: Progress) -> None:
        heard.append(progress.what)
        if len(heard) == 5:
            upkeep.may_end.set()

    assert await run_work(config, RebuildAnswer, hear) == REBUILT
    assert heard[:5] == ["working"] * 5


def test_whoever_waits_is_told_often_enough_that_the_work_goes_on() -> None:
    assert HEARTBEAT_S * 3 < LINE_TIMEOUT_S


@pytest.mark.parametrize(
    ("failure", "code"),
    [
        (BlockRobotError("STORE_UNAVAILABLE", "The store's server failed."), "STORE_UNAVAILABLE"),
        (BlockRobotError("CUSTODY_CATCHING_UP"), "CUSTODY_CATCHING_UP"),
        (ZeroDivisionError(), "INTERNAL"),
    ],
)
async def test_what_fails_on_the_way_reaches_the_command_by_its_code(
    config: NodeConfig, upkeep: ScriptedUpkeep, failure: Exception, code: str
) -> None:
    upkeep.failure = failure
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        await run_work(config, ScrubAnswer, lambda *_: None)


async def test_a_wrong_token_a_missing_one_and_a_node_that_is_down_are_told_apart(
    config: NodeConfig, server: TestServer
) -> None:
    path = config.data_dir / TOKEN_FILE_NAME
    path.write_text("0" * 64)
    codes = []
    for change in (lambda: None, path.unlink):
        change()
        with pytest.raises(BlockRobotError) as refusal:
            await ask_status(config)
        codes.append(refusal.value.code)
    path.write_text(TOKEN)
    await server.close()
    with pytest.raises(BlockRobotError) as refusal:
        await ask_status(config)
    assert [*codes, refusal.value.code] == ["OPERATOR_TOKEN_INVALID", "NODE_UNREACHABLE", "NODE_UNREACHABLE"]


@pytest.mark.parametrize("content", ["[]", "<html></html>", '{"progress": 7}', '{"report": {}}'])
@pytest.mark.parametrize("status", [200, 502])
async def test_an_answer_in_another_form_is_not_called_silence(config: NodeConfig, content: str, status: int) -> None:
    async def answer(_request: web.Request) -> web.Response:
        return web.Response(text=content, status=status)

    application = web.Application()
    application.router.add_get("/custody", answer)
    application.router.add_post("/custody/scrub", answer)
    async with TestServer(application, host="127.0.0.1") as other:
        asked = replace(config, operator_port=other.port or 0)
        for ask in (ask_status(asked), run_work(asked, ScrubAnswer, lambda *_: None)):
            with pytest.raises(BlockRobotError) as refusal:
                await ask
            assert refusal.value.code == "INTERNAL"
