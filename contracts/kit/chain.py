"""A local chain for tests: the real interpreter and state, no nodes.

Sources run in a sandboxed process; each call is a transaction in its own block.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from consensus.limits import CALL_GAS_MAX
from consensus.primitives.encoding import decode_value, encode_value
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import PrivateKey
from contracts.execution.views import VIEW_GAS_MAX
from contracts.kit.engine import Call
from contracts.kit.recorder import LineFigures
from contracts.kit.sandboxed import SandboxedEngine
from contracts.kit.sources import read_source
from contracts.kit.tracing import Trace
from contracts.lifecycle.applying_changes import MIGRATION_GAS_MAX
from contracts.vm import CallContext
from contracts.vm.compiler.invoke import Mode

FIRST_HEIGHT = 1
FIRST_TIME_MS = 1_767_225_600_000
BLOCK_MS = 1_000


class CallFailedError(AssertionError):
    """A call's success, failure or code was not as expected; shows the trace."""

    def __init__(self, sentence: str, trace: Trace) -> None:
        self.trace = trace
        super().__init__(f"{sentence}\n{trace.text()}")


@dataclass(frozen=True, slots=True)
class Caller:
    """A signer; the same name always has the same key."""

    name: str
    private_key: PrivateKey = field(repr=False)

    @property
    def key(self) -> bytes:
        """The 33 bytes seen as `ctx.caller`."""
        return self.private_key.public_key

    def sign(self, tag: str, message: bytes) -> bytes:
        """Return the 65-byte signature from which `recover` yields `key`."""
        return self.private_key.sign(tag, message)


@dataclass(frozen=True, slots=True)
class Event:
    """An event: its contract, name, data and block."""

    contract: str
    name: str
    data: dict[Any, Any]
    height: int


@dataclass(frozen=True, slots=True)
class Called:
    """A call's result; `code` is "OK" on success, `line` is the failing source line."""

    result: Any
    events: tuple[Event, ...]
    gas_used: int
    code: str
    message: str
    line: int | None
    height: int
    txid: bytes


@dataclass(frozen=True, slots=True)
class Deployment:
    """A deployed source, its line figures and the gas of its successful calls."""

    name: str
    source: str
    path: Path | None
    lines: Mapping[int, LineFigures]
    gas: Mapping[str, list[int]]


class Contract:
    """A deployed contract; its calls need no contract name."""

    def __init__(self, chain: Chain, name: str, path: Path | None) -> None:
        self.chain = chain
        self.name = name
        self.path = path

    def call(self, entry: str, *arguments: Any, caller: Caller | str | None = None, gas: int = CALL_GAS_MAX) -> Any:
        """Call an entry in a transaction. Raises CallFailedError."""
        return self.chain.call(self.name, entry, *arguments, caller=caller, gas=gas).result

    def view(self, view: str, *arguments: Any) -> Any:
        return self.chain.view(self.name, view, *arguments)

    def expect_failure(self, code: str, entry: str, *arguments: Any, caller: Caller | str | None = None) -> Called:
        """Call an entry that must fail with `code`. Raises CallFailedError."""
        return self.chain.expect_failure(code, self.name, entry, *arguments, caller=caller)

    @property
    def state(self) -> dict[bytes, Any]:
        return self.chain.state(self.name)

    def events(self, name: str | None = None) -> list[dict[Any, Any]]:
        """Return the data of its events in order; None means every name."""
        return [event.data for event in self.chain.events if event.contract == self.name and name in {None, event.name}]


class Chain:
    """A test chain; `height` and `time_ms` may be set, relative source paths start at `folder`."""

    def __init__(self, *, folder: Path | None = None, height: int = FIRST_HEIGHT, time_ms: int = FIRST_TIME_MS) -> None:
        self.folder = folder or Path()
        self.height = height
        self.time_ms = time_ms
        self.chain_id = tagged_hash("blockrobot/kit-chain")
        self.events: list[Event] = []
        self._sources: list[tuple[str, str, Path | None]] = []
        self._callers: dict[str, Caller] = {}
        self._engine = SandboxedEngine()
        self._numbers = itertools.count(1)

    # Setting up

    def deploy(self, path: str | Path, name: str | None = None) -> Contract:
        """Deploy a source file, replacing a contract of that name and running its @migrate. Raises
        CONTRACT_SOURCE_INVALID.
        """
        place = self.folder / path
        return self.deploy_source(read_source(place), name or place.stem, place.resolve())

    def deploy_source(self, source: str, name: str, path: Path | None = None) -> Contract:
        """Deploy a source text. Raises CONTRACT_SOURCE_INVALID, or CallFailedError if migration fails."""
        migrates_by = self._engine.deploy(source, name)
        self._sources.append((name, source, path))
        if migrates_by:
            try:
                self._transact(name, migrates_by, (), None, "migrate", MIGRATION_GAS_MAX)
            except CallFailedError:
                self._engine.withdraw(name)
                raise
        return Contract(self, name, path)

    def caller(self, name: str) -> Caller:
        """Return a signer; a name has the same key on every chain."""
        if name not in self._callers:
            self._callers[name] = Caller(name, PrivateKey(tagged_hash("blockrobot/kit-caller", name.encode())))
        return self._callers[name]

    def advance(
        self, *, blocks: int = 0, ms: int = 0, seconds: int = 0, minutes: int = 0, hours: int = 0, days: int = 0
    ) -> None:
        self.height += blocks
        self.time_ms += ms + 1_000 * (seconds + 60 * (minutes + 60 * (hours + 24 * days)))

    # Calling

    def call(
        self, contract: str, entry: str, *arguments: Any, caller: Caller | str | None = None, gas: int = CALL_GAS_MAX
    ) -> Called:
        """Call an entry in a block of its own. Raises CallFailedError."""
        return self._transact(contract, entry, arguments, caller, "export", gas)

    def genesis(self, contract: str, entry: str, *arguments: Any) -> Called:
        """Run a @genesis entry without a caller or events. Raises CallFailedError."""
        return self._transact(contract, entry, arguments, None, "genesis", 100 * CALL_GAS_MAX)

    def expect_failure(
        self, code: str, contract: str, entry: str, *arguments: Any, caller: Caller | str | None = None
    ) -> Called:
        """Call an entry that must fail with `code`. Raises CallFailedError."""
        call = self._make_call(contract, entry, arguments, self._context(caller), "export", CALL_GAS_MAX)
        called = self._run(call, keep=False)
        self._next_block()
        if called.code != code:
            sentence = f"{contract}.{entry} came to {called.code} instead of {code}."
            raise CallFailedError(sentence, self._engine.trace(call, _name_of(caller)))
        return called

    def view(self, contract: str, view: str, *arguments: Any) -> Any:
        call = self._make_call(contract, view, arguments, self._context(None, empty=True), "view", VIEW_GAS_MAX)
        called = self._run(call, keep=False)
        if called.code != "OK":
            raise CallFailedError(f"The view {contract}.{view} refused.", self._engine.trace(call, _name_of(None)))
        return called.result

    def trace(self, contract: str, entry: str, *arguments: Any, caller: Caller | str | None = None) -> Trace:
        call = self._make_call(contract, entry, arguments, self._context(caller), "export", CALL_GAS_MAX)
        return self._engine.trace(call, _name_of(caller))

    # Looking

    def state(self, contract: str) -> dict[bytes, Any]:
        rows, _ = self._engine.read_state(contract)
        return {key: decode_value(value) for key, value in rows}

    @property
    def deployments(self) -> list[Deployment]:
        figures = zip(self._sources, self._engine.figures(), strict=True)
        return [Deployment(*source, found.lines, found.gas) for source, found in figures]

    @property
    def state_root(self) -> bytes:
        _, root = self._engine.read_state("")
        return root

    # Inside

    def _context(self, caller: Caller | str | None, *, empty: bool = False) -> CallContext:
        who = self.caller(caller) if isinstance(caller, str) else caller or self.caller("somebody")
        txid = bytes(32) if empty else tagged_hash("blockrobot/kit-tx", next(self._numbers).to_bytes(8, "big"))
        key = bytes(33) if empty else who.key
        return CallContext(caller=key, height=self.height, time_ms=self.time_ms, txid=txid, chain_id=self.chain_id)

    def _next_block(self) -> None:
        self.height += 1
        self.time_ms += BLOCK_MS

    def _transact(
        self, contract: str, entry: str, arguments: tuple[Any, ...], caller: Caller | str | None, mode: Mode, gas: int
    ) -> Called:
        call = self._make_call(contract, entry, arguments, self._context(caller, empty=mode != "export"), mode, gas)
        called = self._run(call, keep=True)
        self._next_block()
        if called.code != "OK":
            raise CallFailedError(f"{contract}.{entry} failed.", self._engine.trace(call, _name_of(caller)))
        if mode == "export":
            self.events.extend(called.events)
        return called

    def _make_call(
        self, contract: str, entry: str, arguments: tuple[Any, ...], context: CallContext, mode: Mode, gas: int
    ) -> Call:
        return Call(contract, entry, encode_value(list(arguments)), context, mode, gas)

    def _run(self, call: Call, *, keep: bool) -> Called:
        ran, height = self._engine.run(call, keep=keep), call.context.height
        return Called(
            result=decode_value(ran.result),
            events=tuple(Event(where, name, decode_value(data), height) for where, name, data in ran.events),
            gas_used=ran.gas_used,
            code=ran.code,
            message=ran.message,
            line=ran.line,
            height=height,
            txid=call.context.txid,
        )


def _name_of(caller: Caller | str | None) -> str:
    return caller if isinstance(caller, str) else "somebody" if caller is None else caller.name
