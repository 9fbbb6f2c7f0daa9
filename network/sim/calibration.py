"""Measures the simulator's cost model on this machine."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Coroutine
from typing import Any

from aiohttp import web
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from consensus.chain.messages import Vote, is_valid_vote, sign_vote
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.keys import PrivateKey
from network.sim.plan import NetworkSize, Plan
from network.sim.run import run_seed
from network.sim.workload import VALID_UNTIL_MS, enrolment
from network.sim.world.cpu import Costs
from network.sim.world.links import KIB
from network.sim.world.sim_chain import EPOCH_MS, make_chain, make_key
from network.sim.world.sim_cluster import SimCluster
from node.mempool.mempool import Mempool
from node.mempool.transaction_cache import TransactionCache
from node.p2p.wire import FinalizedRequest, FrameDecoder, FrameKind, TransactionBatch, encode_frame
from node.storage.memory_store import MemoryStore
from node.sync.block_ranges import read_range
from pages.listening import open_listener, serve

MEASUREMENTS_COUNT = 5
EXECUTED_COUNT = 32
CALLS_COUNT = 200
ROUNDS_COUNT = 40
SIZE = NetworkSize(4, 4)


def measure_costs() -> Costs:
    block_us, execution_us = _block_us()
    return Costs(
        frame=_frame_us(),
        kib=_kib_us(),
        signature=_signature_us(),
        signing=_signing_us(),
        transaction=_transaction_us(),
        execution=execution_us,
        block=block_us,
        request=_request_us(),
        range_kib=_range_kib_us(),
        call=_call_us(),
    )


def _least_us(work: Callable[[], object], times: int) -> float:
    taken_us = []
    for _ in range(MEASUREMENTS_COUNT):
        started_ns = time.process_time_ns()
        for _ in range(times):
            work()
        taken_us.append((time.process_time_ns() - started_ns) / 1_000 / times)
    return min(taken_us)


def _vote() -> tuple[PrivateKey, Vote]:
    key = PrivateKey(make_key("calibration").secret)
    return key, sign_vote(key, bytes(32), 0, 7, bytes(32), 0)


def _frame_us() -> float:
    vote = encode(_vote()[1])

    def pass_on() -> None:
        for _, payload in FrameDecoder().feed(encode_frame(FrameKind.VOTE, vote)):
            decode(payload, Vote)

    return _least_us(pass_on, 2_000)


def _kib_us() -> float:
    content, seal, nonce = bytes(64 * KIB), AESGCM(bytes(16)), bytes(12)

    def pass_on() -> None:
        sealed = seal.encrypt(nonce, encode_frame(FrameKind.TRANSACTIONS, content), None)
        list(FrameDecoder().feed(seal.decrypt(nonce, sealed, None)))

    return _least_us(pass_on, 50) / 64 / 2


def _signature_us() -> float:
    key, vote = _vote()
    return _least_us(lambda: is_valid_vote(vote, bytes(32), key.public_key), 300)


def _signing_us() -> float:
    key, _ = _vote()
    return _least_us(lambda: sign_vote(key, bytes(32), 0, 7, bytes(32), 0), 300)


def _transaction_us() -> float:
    chain, wire = make_chain(SIZE), enrolment(SIZE, 0).transaction.wire
    pool = Mempool(
        chain_id=chain.genesis.chain_id,
        cache=TransactionCache(),
        check_admission=lambda _: True,
        is_spent=lambda _: False,
    )
    payload = encode(TransactionBatch(transactions=(wire,) * 64))

    def read() -> None:
        for each in decode(payload, TransactionBatch).transactions:
            with contextlib.suppress(BlockRobotError):
                pool.admit(each, VALID_UNTIL_MS)

    return _least_us(read, 10) / 64


def _block_us() -> tuple[float, float]:
    chain, ledger = make_chain(SIZE), MemoryStore()
    asyncio.run(ledger.commit([chain.first_block], b""))
    calls = [enrolment(SIZE, client).transaction for client in range(EXECUTED_COUNT)]
    with ledger.snapshot() as snapshot:
        empty_us = _least_us(lambda: chain.machine.build(snapshot, 1, EPOCH_MS + 1, []), 20)
        full_us = _least_us(lambda: chain.machine.build(snapshot, 1, EPOCH_MS + 1, calls), 2)
    return empty_us, max(0.0, full_us - empty_us) / EXECUTED_COUNT


def _request_us() -> float:
    body = encode(FinalizedRequest(from_height=1, count=1))

    async def answer() -> bytes:
        decode(body, FinalizedRequest)
        return encode_frame(FrameKind.RESPONSE, body)

    async def serve() -> None:
        await asyncio.gather(*(asyncio.create_task(answer()) for _ in range(1_000)))

    return _least_us(lambda: asyncio.run(serve()), 1) / 1_000


def _range_kib_us() -> float:
    kept: list[SimCluster] = []
    run_seed(Plan(seed=1, rounds=ROUNDS_COUNT), mutate=kept.append)
    with kept[0].nodes[0].ledger.snapshot() as snapshot:
        size_kib = len(encode(read_range(snapshot, 1, ROUNDS_COUNT))) / KIB
        return _least_us(lambda: encode(read_range(snapshot, 1, ROUNDS_COUNT)), 20) / size_kib


def _call_us() -> float:
    return asyncio.run(_serve_calls())


async def _serve_calls() -> float:
    async def answer(request: web.Request) -> web.Response:
        return web.json_response(await request.json())

    application = web.Application()
    application.router.add_post("/", answer)
    listener = open_listener("127.0.0.1", 0)
    async with serve(application, listener, 1, 0):
        return await _calls_to(listener.getsockname()[1])


async def _calls_to(port: int) -> float:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    body = b'{"transactions": ["' + b"A" * 400 + b'"]}'
    head = f"POST / HTTP/1.1\r\nHost: l\r\nContent-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"

    async def call() -> None:
        writer.write(head.encode() + body)
        lines = (await reader.readuntil(b"\r\n\r\n")).lower().split(b"\r\n")
        size = next(int(line.split(b":")[1]) for line in lines if line.startswith(b"content-length"))
        await reader.readexactly(size)

    try:
        return await _least_of_calls_us(call)
    finally:
        writer.close()


async def _least_of_calls_us(call: Callable[[], Coroutine[Any, Any, None]]) -> float:
    taken_us = []
    for _ in range(MEASUREMENTS_COUNT):
        started_ns = time.process_time_ns()
        for _ in range(CALLS_COUNT):
            await call()
        taken_us.append((time.process_time_ns() - started_ns) / 1_000 / CALLS_COUNT)
    return min(taken_us)
