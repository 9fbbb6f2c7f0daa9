"""Robot, wallet and registrar as processes, driven by command line."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
from msgspec import Struct

from consensus.bounded_text import read_json_text
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.visible_text import split_lines
from network.cluster import machine_words

COMMAND_TIMEOUT_S = 600.0

A = TypeVar("A")


class Progress(Struct, frozen=True):
    """What a robot's process tells on its way."""

    frames_read: int = 0
    frames_recorded: int = 0
    waiting: int = 0


def _command(arguments: list[str], module: str = "network.cli.main") -> list[str]:
    return [sys.executable, "-m", module, *arguments]


def _environment(extra: dict[str, str]) -> dict[str, str]:
    return {**os.environ, **extra}


def _too_slow(arguments: list[str], timeout_s: float) -> BlockRobotError:
    detail = f"`blockrobot {arguments[0]}` did not end in {timeout_s:.0f} s; {machine_words()}."
    return BlockRobotError("COMMAND_TOO_SLOW", detail)


def parse_answer(output: bytes, errors: bytes, arguments: list[str], kind: type[A]) -> A:
    """Raises the child's refusal, or INTERNAL if unreadable."""
    try:
        answer = read_json_text(output)
    except ValueError:
        answer = None
    if not isinstance(answer, dict):
        tail = split_lines(errors.decode(errors="replace").strip())[-1:]
        detail = f"`blockrobot {' '.join(arguments[:3])}` gave no answer: {' '.join(tail)}"
        raise BlockRobotError("INTERNAL", detail)
    problem = answer.get("error")
    if problem:
        code = problem["code"] if problem["code"] in CATALOGUE else "INTERNAL"
        raise BlockRobotError(code, problem["detail"])
    return msgspec.convert(answer, kind)


async def run_command(arguments: list[str], kind: type[A], *, environment: dict[str, str] | None = None) -> A:
    """`blockrobot ARGUMENTS --json`. Raises the command's refusal, COMMAND_TOO_SLOW."""
    process = await asyncio.create_subprocess_exec(
        *_command([*arguments, "--json"]),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=_environment(environment or {}),
    )
    try:
        output, errors = await asyncio.wait_for(process.communicate(), COMMAND_TIMEOUT_S)
    except TimeoutError:
        raise _too_slow(arguments, COMMAND_TIMEOUT_S) from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return parse_answer(output, errors, arguments, kind)


class LongCommand(Generic[A]):
    """Reports progress as JSON lines on standard error."""

    def __init__(
        self,
        arguments: list[str],
        kind: type[A],
        on_progress: Callable[[Progress], None],
        on_start: Callable[[int], None] | None = None,
        *,
        module: str = "network.cli.main",
    ) -> None:
        self._module = module
        self._arguments = arguments
        self._kind = kind
        self._on_progress = on_progress
        self._on_start = on_start

    async def run(self, timeout_s: float) -> A:
        """Raises the command's refusal, COMMAND_TOO_SLOW."""
        process = await asyncio.create_subprocess_exec(
            *_command([*self._arguments, "--json"], self._module),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=1024 * 1024,
        )
        assert process.stdout is not None
        if self._on_start is not None:
            self._on_start(process.pid)
        errors: list[bytes] = []
        follow = asyncio.create_task(self._follow(process, errors))
        try:
            async with asyncio.timeout(timeout_s):
                output = await process.stdout.read()
                await process.wait()
                await follow
        except TimeoutError:
            raise _too_slow(self._arguments, timeout_s) from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
            follow.cancel()
        return parse_answer(output, b"\n".join(errors), self._arguments, self._kind)

    async def _follow(self, process: asyncio.subprocess.Process, errors: list[bytes]) -> None:
        assert process.stderr is not None
        while line := await process.stderr.readline():
            try:
                report = read_json_text(line)
            except ValueError:
                report = None
            if isinstance(report, dict) and "progress" in report:
                self._on_progress(msgspec.convert(report["progress"], Progress))
            else:
                errors.append(line)


def wallet_arguments(folder: Path, profile: str, genesis: Path) -> list[str]:
    return ["wallet", "--wallet-dir", str(folder), "--profile", profile, "--genesis", str(genesis)]
