"""The operator's listener: whose requests it answers, by which name and with which token."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from consensus.errors import BlockRobotError
from node.api_adapters import WallClock
from node.config import READING_TOKEN_FILE_NAME
from node.faults import FaultSwitch, read_or_make_token
from node.operator_listener import OPEN_PATHS, READING_PATHS, create_metrics_listener, create_operator_listener
from tests.resetting import send_and_reset

READING, OPERATOR = {"Authorization": "Bearer reading"}, {"Authorization": "Bearer operator"}


class Status:
    def is_ready(self) -> bool:
        return True

    def problem(self) -> BlockRobotError | None:
        return None

    def describe(self) -> dict[str, str]:
        return {"name": "node-1"}

    def metrics(self) -> bytes:
        return b"figure 1\n"


def listener() -> web.Application:
    return create_operator_listener(Status(), None, "operator", reading_token="reading")


async def test_figures_are_for_who_shows_a_token() -> None:
    async with TestClient(TestServer(listener())) as client:
        for path in READING_PATHS:
            assert [(await client.get(path, headers=shown)).status for shown in (READING, OPERATOR)] == [200, 200]
            for shown in (
                {},
                {"Authorization": "Bearer "},
                {"Authorization": "Bearer \xff"},
                {"Authorization": "reading"},
            ):
                answer = await client.get(path, headers=shown)
                assert (answer.status, (await answer.json())["code"]) == (401, "OPERATOR_TOKEN_INVALID")
        for path in OPEN_PATHS:
            assert (await client.get(path)).status == 200


async def test_other_machines_are_told_whether_it_lives_and_with_a_token_its_figures_and_nothing_else() -> None:
    application = create_metrics_listener(Status(), None, reading_token="reading")
    elsewhere = {"Host": "node-1.clinic.example:9100"}
    async with TestClient(TestServer(application)) as client:
        for path in OPEN_PATHS:
            assert (await client.get(path, headers=elsewhere)).status == 200
            assert (await client.get(path, headers=elsewhere | {"Origin": "https://evil.example"})).status == 403
        assert await (await client.get("/metrics", headers=elsewhere | READING)).text() == "figure 1\n"
        for shown in ({}, OPERATOR, {"Authorization": "Bearer "}):
            answer = await client.get("/metrics", headers=elsewhere | shown)
            assert answer.status == 401
            assert "operator-read.token" in (await answer.json())["detail"]
        for path in ("/status", "/faults", "/custody", "/nothing"):
            assert (await client.get(path, headers=elsewhere | READING)).status == 404
    unarmed = create_metrics_listener(Status(), None, reading_token="")
    async with TestClient(TestServer(unarmed)) as client:
        assert (await client.get("/metrics", headers={"Authorization": "Bearer "})).status == 401


async def test_without_its_token_nothing_is_shown_or_moved_and_a_web_page_is_answered_nothing() -> None:
    async with TestClient(TestServer(create_operator_listener(Status()))) as client:
        for shown in ({}, {"Authorization": "Bearer "}):
            assert (await client.get("/status", headers=shown)).status == 401
    async with TestClient(TestServer(listener())) as client:
        assert (await client.get("/custody", headers=READING)).status == 401
        assert (await client.post("/faults", headers=READING)).status >= 400
    async with TestClient(TestServer(listener())) as client:
        for path in (*OPEN_PATHS, *READING_PATHS):
            assert (await client.get(path, headers=OPERATOR | {"Origin": "http://127.0.0.1:1"})).status == 403


@pytest.mark.parametrize("host", ["evil.example", "evil.example:7274", "127.0.0.1.evil.example", "10.0.0.7:1", ""])
async def test_another_name_than_this_machine_s_is_answered_nothing(host: str) -> None:
    async with TestClient(TestServer(listener())) as client:
        for path in (*OPEN_PATHS, *READING_PATHS, "/faults", "/custody", "/nothing"):
            answer = await client.get(path, headers=OPERATOR | {"Host": host})
            assert (answer.status, (await answer.json())["code"]) == (403, "NOT_PERMITTED")


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:7274", "127.0.0.1:1", "[::1]:7274"])
async def test_this_machine_has_three_names(host: str) -> None:
    async with TestClient(TestServer(listener())) as client:
        assert (await client.get("/status", headers=READING | {"Host": host})).status == 200


def test_the_token_is_for_its_user_alone(tmp_path: Path) -> None:
    token = read_or_make_token(tmp_path, READING_TOKEN_FILE_NAME)
    assert (tmp_path / READING_TOKEN_FILE_NAME).stat().st_mode & 0o777 == 0o600
    assert read_or_make_token(tmp_path, READING_TOKEN_FILE_NAME) == token != read_or_make_token(tmp_path)


async def test_a_client_that_resets_its_connection_writes_no_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    switch = FaultSwitch("node-1", tmp_path, WallClock())
    application = create_operator_listener(Status(), switch, "operator")
    async with TestServer(application) as server:
        await send_and_reset(
            server.port, b"POST /faults HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer operator\r\n"
        )
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.INFO] == []
