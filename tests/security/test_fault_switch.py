"""The fault switch is for the operator alone: everybody else is tried at it, and nothing that they say is done."""

from __future__ import annotations

import errno
import json
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import aiohttp
import pytest
import pytest_asyncio
from aiohttp import web
from aiohttp.test_utils import make_mocked_request

from consensus.errors import BlockRobotError
from node.api_adapters import WallClock
from node.faults import TOKEN_FILE_NAME, FaultSwitch, read_or_make_token
from node.operator_listener import FAULT_REQUEST_MAX_BYTES, create_operator_listener
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import Intruder

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.smoke]

CUT = json.dumps({"links": {"node-2": {"cut": True}}, "disk": {"journal": True}})


def _url(network: NetworkUnderTest, name: str = "node-1") -> str:
    config = network.cluster.config(name)
    return f"http://{config.host}:{config.operator_port}/faults"


def _token(network: NetworkUnderTest, name: str = "node-1") -> str:
    return (network.cluster.config(name).data_dir / TOKEN_FILE_NAME).read_text(encoding="ascii")


@pytest_asyncio.fixture(loop_scope="module")
async def stranger() -> AsyncIterator[aiohttp.ClientSession]:
    async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=10)) as session:
        yield session


async def _refused(session: aiohttp.ClientSession, url: str, headers: Mapping[str, str]) -> str:
    """Try to read and to set; both must be refused alike. Return the code."""
    async with session.get(url, headers=headers) as response:
        assert response.status in {401, 403}
        code = str((await response.json())["code"])
    async with session.post(url, data=CUT, headers=headers) as response:
        assert response.status in {401, 403}
        assert (await response.json())["code"] == code
    return code


async def test_the_token_opens_the_switch_to_its_owner_and_no_web_page(
    network: NetworkUnderTest, stranger: aiohttp.ClientSession
) -> None:
    headers = {"Authorization": f"Bearer {_token(network)}"}
    async with stranger.post(_url(network), data=b'{"clock_offset_ms": 5}', headers=headers) as response:
        assert response.status == 200
        assert (await response.json())["clock_offset_ms"] == 5
    async with stranger.post(_url(network), data=b'{"clear": true}', headers=headers) as response:
        assert (await response.json())["clock_offset_ms"] == 0
    for origin in ("http://127.0.0.1", "null", "https://example.org"):
        headers = {"Authorization": f"Bearer {_token(network)}", "Origin": origin}
        assert await _refused(stranger, _url(network), headers) == "NOT_PERMITTED"


async def test_nobody_else_opens_it_whatever_they_show(
    network: NetworkUnderTest, stranger: aiohttp.ClientSession, intruder: Intruder
) -> None:
    member = await intruder.enrol()
    session = await intruder.session(member.identity)
    shown = [
        "",
        "Bearer",
        "Bearer ",
        f"bearer {_token(network)}",
        f"Bearer {_token(network)[:-1]}",
        f"Bearer {_token(network)}0",
        f"Bearer {_token(network, 'node-2')}",
        f"Basic {_token(network)}",
        session["Authorization"],
        "Bearer ünïcödé",
    ]
    for words in shown:
        headers = {"Authorization": words} if words else {}
        assert await _refused(stranger, _url(network), headers) == "OPERATOR_TOKEN_INVALID"
    headers = {"Authorization": f"Bearer {_token(network)}"}
    async with stranger.get(_url(network), headers=headers) as response:
        state = await response.json()
    assert (state["links"], state["disk"]) == ({}, [])


async def test_clients_do_not_find_it_at_their_own_door(
    network: NetworkUnderTest, stranger: aiohttp.ClientSession
) -> None:
    headers = {"Authorization": f"Bearer {_token(network)}"}
    for path in ("/faults", "/v1/faults"):
        async with stranger.post(network.genesis.nodes[0].api_url + path, data=CUT, headers=headers) as response:
            assert response.status == 404


async def test_no_other_method_and_no_large_body_is_taken(
    network: NetworkUnderTest, stranger: aiohttp.ClientSession
) -> None:
    headers = {"Authorization": f"Bearer {_token(network)}"}
    for method in ("PUT", "DELETE", "PATCH"):
        async with stranger.request(method, _url(network), data=CUT, headers=headers) as response:
            assert response.status == 405
    async with stranger.post(_url(network), data=b" " * (FAULT_REQUEST_MAX_BYTES + 1), headers=headers) as response:
        assert response.status == 413


async def test_the_token_is_for_its_owners_eyes_and_in_no_log(network: NetworkUnderTest) -> None:
    for name in network.names:
        folder = network.cluster.config(name).data_dir
        assert (folder / TOKEN_FILE_NAME).stat().st_mode & 0o077 == 0
        for path in (folder / "node.log", folder / "output.log"):
            assert _token(network, name) not in path.read_text(encoding="utf-8")


class _Status:
    def is_ready(self) -> bool:
        return True

    def describe(self) -> Mapping[str, Any]:
        return {}

    def metrics(self) -> bytes:
        return b""


async def _ask(application: web.Application, headers: Mapping[str, str], remote: str) -> tuple[int, dict[str, Any]]:
    """Ask an application without a socket, as if from this address."""
    request = make_mocked_request("GET", "/faults", headers=headers, app=application).clone(remote=remote)
    match = await application.router.resolve(request)
    response = await match.handler(request)
    assert isinstance(response, web.Response)
    assert isinstance(response.body, bytes)
    return response.status, json.loads(response.body)


async def test_a_node_whose_configuration_does_not_allow_it_has_no_switch(tmp_path: Path) -> None:
    token = read_or_make_token(tmp_path)
    for application in (
        create_operator_listener(_Status()),
        create_operator_listener(_Status(), None, token),
        create_operator_listener(_Status(), FaultSwitch("node-1", tmp_path, WallClock()), ""),
    ):
        for headers in ({"Authorization": f"Bearer {token}"}, {"Authorization": "Bearer "}, {}):
            assert (await _ask(application, headers, "127.0.0.1"))[1]["code"] == "FAULTS_DISABLED"


async def test_another_machine_does_not_open_it_even_with_the_token(tmp_path: Path) -> None:
    token = read_or_make_token(tmp_path)
    application = create_operator_listener(_Status(), FaultSwitch("node-1", tmp_path, WallClock()), token)
    headers = {"Authorization": f"Bearer {token}"}
    for remote in ("10.0.0.7", "192.168.1.2", "2001:db8::1"):
        assert (await _ask(application, headers, remote))[1]["code"] == "NOT_PERMITTED"
    for remote in ("127.0.0.1", "::1"):
        assert (await _ask(application, headers, remote))[0] == 200


async def test_a_refused_request_fills_no_disk(tmp_path: Path) -> None:
    switch = FaultSwitch("node-1", tmp_path, WallClock())
    with pytest.raises(BlockRobotError):
        switch.request(b'{"disk": {"journal": true}, "nonsense": 1}')
    switch.require_space("journal")
    switch.request(b'{"disk": {"journal": true}}')
    with pytest.raises(OSError, match="space") as full:
        switch.require_space("journal")
    assert full.value.errno == errno.ENOSPC
