"""One contract, one host in memory, one call: what the tests of the language are written with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from contracts.vm import (
    CallContext,
    CompiledContract,
    ContractSourceError,
    Diagnostic,
    Outcome,
    compile_contract,
    invoke,
)
from tests.frozen_heap import frozen_heap

__all__ = ["frozen_heap"]

CALLER = b"\x02" + b"c" * 32
CONTEXT = CallContext(caller=CALLER, height=7, time_ms=1_700_000_000_000, txid=b"t" * 32, chain_id=b"i" * 32)


@dataclass
class DictHost:
    entries: dict[bytes, bytes] = field(default_factory=dict)
    emitted: list[tuple[str, bytes]] = field(default_factory=list)

    def get(self, key: bytes) -> bytes | None:
        return self.entries.get(key)

    def put(self, key: bytes, value: bytes) -> None:
        self.entries[key] = value

    def delete(self, key: bytes) -> None:
        self.entries.pop(key, None)

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        return [(key, self.entries[key]) for key in sorted(self.entries) if key.startswith(prefix)][:limit]

    def emit(self, name: str, data: bytes) -> None:
        self.emitted.append((name, data))


class Bench:
    """Contracts on one host."""

    def __init__(self) -> None:
        self.host = DictHost()
        self.contracts: dict[str, CompiledContract] = {}
        self.gas_limit = 250_000

    def deploy(self, name: str, source: str) -> CompiledContract:
        self.contracts[name] = compile_contract(source, name)
        return self.contracts[name]

    def call(self, target: str, *args: Any, mode: Any = "export") -> Outcome:
        contract, entry = target.split(".")
        return invoke(
            self.contracts, contract, entry, list(args),
            host=self.host, context=CONTEXT, gas_limit=self.gas_limit, mode=mode,
        )  # fmt: skip


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def run(bench: Bench) -> Callable[..., Outcome]:
    """Run the body of an entry `f(a, b, ...)` on values; the body starts in line 4."""

    def run_body(body: str, *args: Any, before: str = "") -> Outcome:
        params = ", ".join(f"{name}: object" for name in "abcdef"[: len(args)])
        indented = "\n".join("    " + line for line in body.splitlines())
        bench.deploy("it", f"{before}\n@export\ndef f({params}):\n{indented}\n")
        return bench.call("it.f", *args)

    return run_body


@pytest.fixture
def value(run: Callable[..., Outcome]) -> Callable[..., Any]:
    """Return the value of an expression; fails the test if it fails."""

    def value_of(expression: str, *args: Any, before: str = "") -> Any:
        outcome = run(f"return {expression}", *args, before=before)
        assert outcome.ok, outcome
        return outcome.result

    return value_of


@pytest.fixture
def code(run: Callable[..., Outcome]) -> Callable[..., str]:
    """Return the code with which an expression fails."""

    def code_of(expression: str, *args: Any, before: str = "") -> str:
        return run(f"return {expression}", *args, before=before).code

    return code_of


@pytest.fixture
def problems() -> Callable[[str], tuple[Diagnostic, ...]]:
    """Return the diagnostics of a source; fails the test if there are none."""

    def problems_of(source: str) -> tuple[Diagnostic, ...]:
        with pytest.raises(ContractSourceError) as caught:
            compile_contract(source, "it")
        return caught.value.diagnostics

    return problems_of
