"""A contract worker with a hole, for tests only: its `sha256` runs the Python that stands behind `python:`.

All that an intruder could wish for is loaded before the sandbox is entered, so that only the sandbox is in their way.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import contracts.vm.builtins.host as vm_host
from consensus.chain.transaction import Transaction
from consensus.primitives import hashing
from consensus.primitives.encoding import encode_value
from contracts.execution.executor import execute_block
from contracts.execution.results import BlockContext, BlockResult, note_nothing
from contracts.execution.views import run_view
from contracts.state.view import StateReader, StateView
from contracts.vm import compile_contract
from contracts.worker.process import WorkerTools
from contracts.worker.wire import Begin
from node.execution.contract_worker import main, prepare

SOURCE = '''
@view
def look(data: bytes) -> bytes:
    """Hash."""
    return sha256(data)


@export
def put(key: bytes, data: bytes):
    """Store a hash."""
    state.put(key, sha256(data))
'''
MARK = b"python:"
TAKE = b"take:"
"""What stands behind it is how many bytes to take, as an operation of the interpreter would."""
LOOT = {
    "ctypes": ctypes, "mmap": mmap, "os": os, "resource": resource, "signal": signal, "socket": socket,
    "subprocess": subprocess, "sys": sys, "libc": ctypes.CDLL(None, use_errno=True),
}  # fmt: skip


def holed_sha256(data: bytes) -> bytes:
    """Hash, or run Python and return what came of it."""
    if data.startswith(TAKE):
        return hashing.sha256(bytearray(int(data.removeprefix(TAKE)))[:1])
    if not data.startswith(MARK):
        return hashing.sha256(data)
    try:
        return repr(eval(data.removeprefix(MARK).decode(), LOOT)).encode()[:4000]
    except MemoryError:
        return b"MemoryError: "
    except Exception as error:  # noqa: BLE001 - the intruder wants to know
        return f"{type(error).__name__}: {error}".encode()


class HoledMachine:
    """Executes blocks of the one contract."""

    def __init__(self) -> None:
        self.contracts = {"hole": compile_contract(SOURCE, "hole")}

    def build(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        note: Callable[[int], None] = note_nothing,
    ) -> tuple[BlockResult, list[bytes]]:
        context = BlockContext(bytes(32), height, time_ms)
        result = execute_block(parent, self.contracts, context, transactions, leader=True, note=note)
        return result, list(result.faulty)

    def verify(
        self,
        parent: StateView,
        height: int,
        time_ms: int,
        transactions: Sequence[Transaction],
        *,
        gives_up_change: bool = False,
        note: Callable[[int], None] = note_nothing,
    ) -> BlockResult:
        context = BlockContext(bytes(32), height, time_ms)
        return execute_block(parent, self.contracts, context, transactions, note=note)

    def run_view(
        self, state: StateReader, height: int, time_ms: int, contract: str, view: str, arguments: list[Any]
    ) -> bytes:
        return encode_value(
            run_view(state, self.contracts, BlockContext(bytes(32), height, time_ms), contract, view, arguments)
        )


def prepare_holed(begin: Begin) -> WorkerTools:
    """Prepare as the real worker does, then put the hole in."""
    place = prepare(begin)
    vm_host.hashing = SimpleNamespace(**{**vars(hashing), "sha256": holed_sha256})
    machine = HoledMachine()
    return replace(place, machine=machine, run_view=machine.run_view)


if __name__ == "__main__":
    sys.exit(main(prepare_holed))
