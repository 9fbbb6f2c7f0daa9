"""Queries custodians over their operator listeners with their data directories' tokens."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TypeVar

import aiohttp
import msgspec

from consensus.api_documents import Document
from consensus.bounded_text import read_json_as
from consensus.errors import CATALOGUE, BlockRobotError
from node.config import OPERATOR_HOST, NodeConfig
from node.custody.coordination.custody_answers import (
    CustodyProblem,
    CustodyStatus,
    Progress,
    RebuildAnswer,
    ScrubAnswer,
    WorkLine,
)
from node.faults import TOKEN_FILE_NAME

STATUS_TIMEOUT_S = 10.0
LINE_TIMEOUT_S = 120.0
_LINE_MAX_BYTES = 16 * 1024 * 1024
_WORK_PATHS: dict[type[Document], str] = {ScrubAnswer: "/custody/scrub", RebuildAnswer: "/custody/rebuild"}
R = TypeVar("R", ScrubAnswer, RebuildAnswer)

OnProgress = Callable[[str, Progress], None]
"""Told of a node's progress, by its name."""


def _headers(config: NodeConfig) -> dict[str, str]:
    try:
        token = (config.data_dir / TOKEN_FILE_NAME).read_text(encoding="ascii")
    except FileNotFoundError:
        raise BlockRobotError(
            "NODE_UNREACHABLE", f"{config.name} has never run, so it has no operator's token."
        ) from None
    except OSError:
        raise BlockRobotError(
            "OPERATOR_TOKEN_INVALID", f"Only who may read the data directory of {config.name} may ask that."
        ) from None
    return {"Authorization": f"Bearer {token}"}


def _url(config: NodeConfig, path: str) -> str:
    return f"http://{OPERATOR_HOST}:{config.operator_port}{path}"


def _refusal(problem: CustodyProblem) -> BlockRobotError:
    return BlockRobotError(problem.code if problem.code in CATALOGUE else "INTERNAL", problem.detail)


def _unreachable(config: NodeConfig) -> BlockRobotError:
    return BlockRobotError("NODE_UNREACHABLE", f"{config.name} does not answer on its operator's port.")


def _not_read(config: NodeConfig) -> BlockRobotError:
    return BlockRobotError("INTERNAL", f"{config.name} answers in another form; compare versions.")


async def ask_status(config: NodeConfig) -> CustodyStatus:
    """Raises NODE_UNREACHABLE, INTERNAL for another form, CUSTODY_ELSEWHERE, STORE_UNAVAILABLE, OPERATOR_*."""
    headers = _headers(config)
    async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=STATUS_TIMEOUT_S)) as session:
        try:
            async with session.get(_url(config, "/custody"), headers=headers) as response:
                content = await response.read()
                if response.status != 200:
                    raise _refusal(read_json_as(content, CustodyProblem))
                return read_json_as(content, CustodyStatus)
        except (aiohttp.ClientError, TimeoutError):
            raise _unreachable(config) from None
        except ValueError:
            raise _not_read(config) from None


async def run_work(config: NodeConfig, kind: type[R], on_progress: OnProgress, *, after: bytes = b"") -> R:
    """Scrub (records after that one) or rebuild, by the report that is wanted. Raises as `ask_status`, and
    CUSTODY_CATCHING_UP.
    """
    parameters = {"after": after.hex()} if after else {}
    headers = _headers(config)
    timeout = aiohttp.ClientTimeout(total=None, connect=STATUS_TIMEOUT_S, sock_read=LINE_TIMEOUT_S)
    async with aiohttp.ClientSession(timeout=timeout, read_bufsize=_LINE_MAX_BYTES) as session:
        try:
            async with session.post(_url(config, _WORK_PATHS[kind]), headers=headers, params=parameters) as response:
                if response.status != 200:
                    raise _refusal(read_json_as(await response.read(), CustodyProblem))
                async for line in response.content:
                    answer = read_json_as(line, WorkLine)
                    if isinstance(answer.progress, Progress):
                        on_progress(config.name, answer.progress)
                    elif isinstance(answer.error, CustodyProblem):
                        raise _refusal(answer.error)
                    elif isinstance(answer.report, msgspec.Raw):
                        return read_json_as(bytes(answer.report), kind)
        except (aiohttp.ClientError, TimeoutError):
            raise _unreachable(config) from None
        except ValueError:
            raise _not_read(config) from None
    raise BlockRobotError("NODE_UNREACHABLE", f"{config.name} stopped before it was done; ask again.")


async def ask_all(configs: list[NodeConfig]) -> list[CustodyStatus | BlockRobotError]:
    """Concurrently; a refusal takes its answer's place."""

    async def one(config: NodeConfig) -> CustodyStatus | BlockRobotError:
        try:
            return await ask_status(config)
        except BlockRobotError as error:
            return error

    return list(await asyncio.gather(*(one(config) for config in configs)))
