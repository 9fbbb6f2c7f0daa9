"""The sandboxed test chain: compiled contracts, their state, line costs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import msgspec

from consensus.primitives.encoding import decode_value, encode_value
from consensus.state.keys import flat_prefix
from contracts.execution.call_host import CallHost
from contracts.kit.arguments import format_short
from contracts.kit.recorder import LineFigures, Recorder
from contracts.kit.tracing import Trace
from contracts.state.view import MemoryState
from contracts.vm import CallContext, CompiledContract, Outcome, compile_contract, invoke
from contracts.vm.compiler.invoke import Mode
from contracts.vm.model.faults import ContractSourceError

SCAN_MAX_COUNT = 100_000
_RECURSION_LIMIT_FRAMES = 15_000


class Call(msgspec.Struct, frozen=True):
    """One call of an entry or view; `arguments` is an encoded list."""

    contract: str
    entry: str
    arguments: bytes
    context: CallContext
    mode: Mode
    gas: int


class Ran(msgspec.Struct, frozen=True):
    """A call's result, as in `contracts.vm.Outcome`; `result` is an encoded value."""

    code: str
    message: str
    line: int | None
    result: bytes
    gas_used: int
    events: list[tuple[str, str, bytes]]

    @property
    def ok(self) -> bool:
        return self.code == "OK"


class Figures(msgspec.Struct, frozen=True):
    """One source's runs and gas per line, and gas per successful call."""

    lines: dict[int, LineFigures]
    gas: dict[str, list[int]]


@dataclass(frozen=True, slots=True)
class _Deployment:
    source: str
    compiled: CompiledContract
    lines: dict[int, LineFigures]
    gas: dict[str, list[int]] = field(default_factory=dict)


class Engine:
    """One chain's contracts and state."""

    def __init__(self) -> None:
        self._recorder = Recorder()
        self._all: list[_Deployment] = []
        self._versions: dict[str, list[_Deployment]] = {}
        self._state = MemoryState()

    def deploy(self, source: str, name: str) -> str:
        """Activate a source; return its migration entry, if any. Raises ContractSourceError."""
        watch = self._recorder.watch(name)
        try:
            made = _Deployment(source, compile_contract(source, name, watch=watch), watch.lines)
        except ContractSourceError:
            self._count_lines_of(name)
            raise
        versions = self._versions.setdefault(name, [])
        versions.append(made)
        self._all.append(made)
        migrations = (one.name for one in made.compiled.abi.entries if one.kind == "migrate")
        return next(migrations, "") if len(versions) > 1 else ""

    def withdraw(self, name: str) -> None:
        self._versions[name].pop()
        self._count_lines_of(name)

    def _count_lines_of(self, name: str) -> None:
        if versions := self._versions.get(name):
            self._recorder.lines[name] = versions[-1].lines

    def run(self, call: Call, *, keep: bool) -> Ran:
        """Make a call; its writes stay if it succeeds and `keep` is set."""
        host = CallHost(self._state)
        self._recorder.begin(tracing=False)
        outcome = self._invoke(call, host)
        self._recorder.finish(call.contract, self._line_of(call), outcome.gas_used)
        if outcome.ok:
            self._versions[call.contract][-1].gas.setdefault(call.entry, []).append(outcome.gas_used)
            if keep:
                host.keep()
                self._state.apply(host.writes)
        result = encode_value(outcome.result)
        return Ran(outcome.code, outcome.message, outcome.line, result, outcome.gas_used, outcome.events)

    def trace(self, call: Call, who: str) -> Trace:
        self._recorder.begin(tracing=True)
        outcome = self._invoke(call, CallHost(self._state))
        self._recorder.finish(call.contract, 0, outcome.gas_used)
        shown = ", ".join(format_short(value) for value in decode_value(call.arguments))
        return Trace(
            title=f"{call.contract}.{call.entry}({shown}) by {who} in block {call.context.height}",
            code=outcome.code,
            message=outcome.message,
            line=outcome.line,
            gas_used=outcome.gas_used,
            steps=tuple(self._recorder.steps),
            left_out_count=self._recorder.left_out_count,
            sources={name: versions[-1].source for name, versions in self._versions.items() if versions},
        )

    def read_state(self, contract: str) -> tuple[list[tuple[bytes, bytes]], bytes]:
        """Return a contract's keys and encoded values, and the 32-byte state root."""
        prefix = flat_prefix(contract)
        rows = [(key[len(prefix) :], value) for key, value in self._state.scan(prefix, SCAN_MAX_COUNT)]
        return rows, self._state.state_root

    def figures(self) -> list[Figures]:
        return [Figures(one.lines, one.gas) for one in self._all]

    def _invoke(self, call: Call, host: CallHost) -> Outcome:
        contracts = {name: versions[-1].compiled for name, versions in self._versions.items() if versions}
        given: list[Any] = decode_value(call.arguments)
        with watched_stack():
            return invoke(
                contracts, call.contract, call.entry, given,
                host=host, context=call.context, gas_limit=call.gas, mode=call.mode,
            )  # fmt: skip

    def _line_of(self, call: Call) -> int:
        versions = self._versions.get(call.contract)
        found = versions[-1].compiled.abi.entry(call.entry) if versions else None
        return 0 if found is None else found.line


@contextmanager
def watched_stack() -> Iterator[None]:
    """Enlarge the stack: watched statements take two frames each."""
    before = sys.getrecursionlimit()
    sys.setrecursionlimit(max(before, _RECURSION_LIMIT_FRAMES))
    try:
        yield
    finally:
        sys.setrecursionlimit(before)
