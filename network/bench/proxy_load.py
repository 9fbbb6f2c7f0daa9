"""Whether members behind one proxy are refused because of each other: many submit at once through nginx to one node."""

from __future__ import annotations

import asyncio
import re
import secrets
import tempfile
import time
from collections import Counter
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import aiohttp
import msgspec
from msgspec import Struct

from clients.sdk.chain.transactions import SystemClock
from clients.sdk.connections import Connections, NodeAddress, tls_context
from clients.sdk.node_answers import error_of, read_answer, read_problem
from clients.sdk.sessions import Sessions
from consensus.api_documents import SubmitAnswer
from consensus.chain.genesis import NodeEntry
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from network.bench.conditions import Result, latency_figures, measure_conditions
from network.bench.event_follower import FinalityFollower
from network.bench.fresh_network import HOST, FreshNetwork, LoadRobot, find_base_port
from network.bench.nginx import Nginx, configure
from network.provisioning.node_certificates import issue_into

Apart = Literal["address", "session"]
ANSWER_MAX_S, FINAL_MAX_S = 20.0, 30.0
_PROXY_REFUSED = "status 503"
_MEMBERS = "127.0.1"
"""Members call from addresses of this network; the proxy tells the node another one, since loopback's budget is larger."""
_TOLD = "10.0.1"
_FORWARDED = "X-Forwarded-For $remote_addr;"
_MAP = f"map $remote_addr $member {{ ~^{_MEMBERS.replace('.', '[.]')}[.](?<number>[0-9]+)$ {_TOLD}.$number; }}\n"


@dataclass(frozen=True, slots=True)
class ProxyOptions:
    """Members, what they submit all together, in how long, and what tells them apart."""

    members: int = 50
    count: int = 2_000
    seconds: float = 10.0
    nodes: int = 4
    apart: Apart = "address"


class ProxyFigures(Struct, kw_only=True):
    """`refused_own`: a budget that the answer names as the member's; `refused_others`: somebody else's, or by the proxy.

    `refused_full`: the pool is full; `failed`: no answer in 20 s, or another error.
    """

    submitted: int
    accepted: int
    final: int
    refused_others: int
    refused_own: int
    refused_full: int
    failed: int
    codes: dict[str, int]
    seconds: float
    p50_ms: float
    p95_ms: float
    p99_ms: float
    mean_ms: float


@dataclass(slots=True)
class _Tally:
    answers_ms: list[float] = field(default_factory=list)
    accepted: list[bytes] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)

    def note(self, txid: bytes, error: BlockRobotError | None, own: str) -> None:
        if error is None:
            self.accepted.append(txid)
            return
        self.codes[error.code] += 1
        if error.code == "INTERNAL" and _PROXY_REFUSED in str(error):
            self.kinds["others"] += 1
        elif error.code == "RATE_LIMITED":
            self.kinds["own" if re.search(rf"{re.escape(own)}(?![0-9])", str(error)) else "others"] += 1
        else:
            self.kinds[{"SENDER_LIMIT": "own", "MEMPOOL_FULL": "full"}.get(error.code, "failed")] += 1


class _Member:
    def __init__(self, number: int, robot: LoadRobot, options: ProxyOptions, proxy: NodeAddress, tally: _Tally) -> None:
        self._robot = robot
        self._proxy = proxy
        self._tally = tally
        self._every_s = options.seconds * options.members / options.count
        self._begin_s = self._every_s * number / options.members
        self._headers = {"Content-Type": "application/msgpack"}
        by_address = options.apart == "address"
        self._own = f"{_TOLD}.{number + 1}" if by_address else robot.key.public_key.hex()
        self._address = f"{_MEMBERS}.{number + 1 if by_address else 1}"
        share = options.count // options.members + (number < options.count % options.members)
        self.signed = [robot.sign_record() for _ in range(share)]

    async def open_session(self, network: FreshNetwork) -> None:
        connections = Connections()
        try:
            sessions = Sessions(network.genesis.chain_id, connections, SystemClock())
            self._headers["Authorization"] = f"Bearer {await sessions.token(self._proxy, self._robot.key)}"
        finally:
            await connections.close()

    async def run(self) -> None:
        """At its own pace, whether or not it was answered."""
        connector = aiohttp.TCPConnector(local_addr=(self._address, 0), ssl=tls_context(self._proxy))
        timeout = aiohttp.ClientTimeout(total=ANSWER_MAX_S)
        async with aiohttp.ClientSession(connector=connector, timeout=timeout) as session:
            started_s, calls = time.perf_counter() + self._begin_s, []
            for number, transaction in enumerate(self.signed):
                await asyncio.sleep(max(0.0, started_s + number * self._every_s - time.perf_counter()))
                calls.append(asyncio.create_task(self._submit(session, transaction)))
            await asyncio.gather(*calls)

    async def _submit(self, session: aiohttp.ClientSession, transaction: Transaction) -> None:
        body, begun_s = msgspec.msgpack.encode([transaction.wire]), time.perf_counter()
        url = f"{self._proxy.url}/v1/transactions"
        try:
            async with session.post(url, data=body, headers=self._headers) as response:
                content, status = await response.read(), response.status
            if status >= 300:
                raise read_problem(content, status)
            (result,) = read_answer(content, SubmitAnswer).results
            error = None if result.error is None else error_of(result.error)
        except BlockRobotError as problem:
            error = problem
        except (aiohttp.ClientError, TimeoutError, OSError) as problem:
            error = BlockRobotError("NODE_UNREACHABLE", type(problem).__name__)
        self._tally.answers_ms.append((time.perf_counter() - begun_s) * 1000)
        self._tally.note(transaction.txid, error, self._own)


def _start_proxy(network: FreshNetwork, node: NodeEntry, place: Path) -> tuple[Nginx, NodeAddress]:
    certificates, port = place / "certificates", find_base_port(1)
    issue_into(certificates, network.authority(node.organisation), f"proxy-{secrets.token_hex(4)}", HOST)
    text = configure(node.api_url.removeprefix("http://"), f"{HOST}:{port}", HOST, certificates)
    text = _MAP + text.replace(_FORWARDED, "X-Forwarded-For $member;")
    authority = next(each for each in network.genesis.organisations if each.name == node.organisation).ca_certificate
    return Nginx(place / "nginx", text), NodeAddress(node.name, f"https://{HOST}:{port}", authority)


async def run_proxy_benchmark(options: ProxyOptions) -> Result[ProxyFigures]:
    """`ok` is False if anybody was refused because of others, or not answered."""
    conditions = measure_conditions(
        nodes=options.nodes, clients=options.members, calls=options.count, call="records.record", apart=options.apart
    )
    tally = _Tally()
    async with AsyncExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="blockrobot-proxy-")))
        network = await stack.enter_async_context(FreshNetwork(options.nodes, proxy=HOST))
        node = network.genesis.nodes[0]
        nginx, proxy = _start_proxy(network, node, place)
        stack.enter_context(nginx)
        robots = await network.enrol_robots(options.members)
        members = [_Member(number, robot, options, proxy, tally) for number, robot in enumerate(robots)]
        if options.apart == "session":
            for member in members:
                await member.open_session(network)
        follower = await stack.enter_async_context(FinalityFollower(network.genesis, node, robots[0].key))
        finals = follower.expect([each.txid for member in members for each in member.signed])
        begun_s = time.perf_counter()
        await asyncio.gather(*(member.run() for member in members))
        seconds = time.perf_counter() - begun_s
        waiting = [finals[txid] for txid in tally.accepted]
        final = (await asyncio.wait(waiting, timeout=FINAL_MAX_S))[0] if waiting else set()
    kinds = tally.kinds
    figures = ProxyFigures(
        submitted=len(tally.answers_ms),
        accepted=len(tally.accepted),
        final=len(final),
        refused_others=kinds["others"],
        refused_own=kinds["own"],
        refused_full=kinds["full"],
        failed=kinds["failed"],
        codes=dict(tally.codes),
        seconds=round(seconds, 2),
        **latency_figures(tally.answers_ms),
    )
    is_ok = figures.accepted > 0 and not figures.refused_others and not figures.failed
    return Result(name="proxy", ok=is_ok, figures=figures, conditions=conditions)
