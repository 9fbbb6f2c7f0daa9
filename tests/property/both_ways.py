"""One program run both ways, in the machine and under plain CPython. Needs nothing but the contract machine."""

from __future__ import annotations

import re
from hashlib import sha256
from pathlib import Path
from random import Random
from typing import Any

from consensus.primitives.encoding import decode_value
from contracts.vm import CallContext, ContractSourceError, Outcome, compile_contract, invoke
from tests.property.contract_programs import ProgramWriter
from tests.property.plain_python import run_plainly

CONTEXT = CallContext(caller=b"c" * 33, height=1, time_ms=2, txid=b"t" * 32, chain_id=b"i" * 32)
BUDGETS = {"OUT_OF_GAS", "MEMORY_BUDGET", "CALL_DEPTH", "WRITE_BUDGET", "EVENT_BUDGET"}
LIMITS = ("A stored value", "An event's data", "A result", "A key of a dict", "An integer key of a dict", "At most ")

OTHER = compile_contract(
    """\
@view
def echo(value: object) -> object:
    return value


@view
def total(values: list) -> int:
    return sum(values)


@export
def keep(value: object):
    state.put(b"kept", value)
""",
    "other",
)
TOKENS = (Path(__file__).parent / "spoilt_sources.txt").read_text("utf-8").split()


class DictHost:
    def __init__(self) -> None:
        self.entries: dict[bytes, bytes] = {}
        self.events: list[tuple[str, Any]] = []

    def get(self, key: bytes) -> bytes | None:
        return self.entries.get(key)

    def put(self, key: bytes, value: bytes) -> None:
        self.entries[key] = value

    def delete(self, key: bytes) -> None:
        self.entries.pop(key, None)

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        return [(key, self.entries[key]) for key in sorted(self.entries) if key.startswith(prefix)][:limit]

    def emit(self, name: str, data: bytes) -> None:
        self.events.append((name, decode_value(data)))


def run(source: str, arguments: list[Any]) -> tuple[Outcome, DictHost]:
    host = DictHost()
    contracts = {"it": compile_contract(source, "it"), "other": OTHER}
    outcome = invoke(contracts, "it", "f", arguments, host=host, context=CONTEXT, gas_limit=2_000_000, mode="export")
    return outcome, host


def compare(source: str, arguments: list[Any]) -> str:
    """Run a program both ways; return how it ended. Fails the test where the ends differ."""
    outcome, host = run(source, arguments)
    if outcome.code in BUDGETS or outcome.message.startswith(LIMITS):
        return "BUDGET"
    code, result, events, state = run_plainly(source, arguments)
    assert outcome.code == code, (
        f"{outcome.code} here, {code} in Python: {outcome.message} (line {outcome.line})\n{source}"
    )
    if outcome.ok:
        stored = {
            key.removeprefix(b"it\x00"): decode_value(value)
            for key, value in host.entries.items()
            if key.startswith(b"it\x00")
        }
        assert (outcome.result, host.events, stored) == (result, events, state), source
        assert repr(outcome.result) == repr(result), source
    return outcome.code


def arguments_of(random: Random) -> list[Any]:
    number = random.choice([0, 1, -1, 3, 2**64, -(2**200), 2**256 - 1])
    text = random.choice(["", "a", "a,b", "12", "é", "Ab 9"])
    numbers = random.choice([[], [1], [3, 1, 2], [2**255, 5]])
    table = random.choice([{}, {"a": 1}, {"b": 2, "a": -1, "": 0}])
    return [number, text, numbers, table]


def digest_of_programs(count: int) -> str:
    """Run numbered programs both ways; return a digest of all sources, outcomes and charges."""
    digest = sha256()
    for number in range(count):
        random = Random(number)
        source = ProgramWriter(random).program()
        arguments = arguments_of(random)
        compare(source, arguments)
        outcome, _ = run(source, arguments)
        said = (outcome.code, outcome.message, outcome.line, outcome.gas_used, outcome.result, outcome.events)
        digest.update(f"{source}{said!r}".encode())
    return digest.hexdigest()


def spoil(random: Random, source: str) -> str:
    """Return a source with a few of its tokens exchanged, left out, doubled or joined by others."""
    parts = re.findall(r"\w+|\s+|[^\w\s]", source)
    for _ in range(random.randrange(1, 4)):
        place = random.randrange(len(parts))
        old, new = parts[place], TOKENS[random.randrange(len(TOKENS))]
        ways = ([new], [], [old, old], [old, " ", new, " "], [old, new], [" ", new, " "], ["\n"])
        parts[place : place + 1] = ways[random.randrange(len(ways))]
    return "".join(parts)


def verdict_of(source: str) -> str:
    """Return what every machine says of a source: its ABI, or its one verdict."""
    try:
        return repr(compile_contract(source, "it").abi)
    except ContractSourceError as error:
        return repr(error.verdict)


def digest_of_readings(count: int) -> str:
    """Compile numbered spoilt programs; return a digest of what was said of them."""
    digest = sha256()
    for number in range(count):
        random = Random(number)
        source = spoil(random, ProgramWriter(random).program())
        digest.update(f"{source}{verdict_of(source)}".encode("utf-8", "replace"))
    return digest.hexdigest()
