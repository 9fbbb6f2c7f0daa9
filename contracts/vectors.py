"""Golden vectors: exact call outcomes, including gas, checked on any machine.

A JSON object: `contracts` (name -> source lines, null if shipped), `calls` in order on one initially empty state,
`refused` sources. Special values: {"bytes": hex}, {"int": decimal}, {"dict": pairs}.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import EXACT_INTEGER_END, decode_value
from contracts.execution.call_host import CallHost
from contracts.lifecycle.registry import read_source
from contracts.state.view import MemoryState
from contracts.vm import LANGUAGE_VERSION, CallContext, CompiledContract, ContractSourceError, compile_contract, invoke

GAS_DEFAULT = 250_000
_CONTEXT: dict[str, Any] = {
    "caller": b"\x02" + b"c" * 32, "height": 7, "time_ms": 1_700_000_000_000, "txid": b"t" * 32, "chain_id": b"i" * 32,
}  # fmt: skip


def to_json(value: Any) -> Any:
    if isinstance(value, bytes):
        return {"bytes": value.hex()}
    if type(value) is int and abs(value) >= EXACT_INTEGER_END:
        return {"int": str(value)}
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    if isinstance(value, dict):
        return {"dict": [[to_json(key), to_json(item)] for key, item in value.items()]}
    return value


def from_json(value: Any) -> Any:
    if isinstance(value, list):
        return [from_json(item) for item in value]
    if isinstance(value, dict):
        ((kind, content),) = value.items()
        if kind == "bytes":
            return bytes.fromhex(content)
        return int(content) if kind == "int" else {from_json(key): from_json(item) for key, item in content}
    return value


def play(document: dict[str, Any]) -> dict[str, Any]:
    contracts = {name: _compile(name, lines) for name, lines in document.get("contracts", {}).items()}
    state = MemoryState()
    calls = [{**call, "outcome": _play_call(contracts, state, call)} for call in document.get("calls", [])]
    refused = [_play_refused(case) for case in document.get("refused", [])]
    return {**document, "language": LANGUAGE_VERSION, "calls": calls, "refused": refused}


def _compile(name: str, lines: list[str] | None) -> CompiledContract:
    return compile_contract(read_source(name) if lines is None else "\n".join(lines), name)


def _play_call(contracts: dict[str, CompiledContract], state: MemoryState, call: dict[str, Any]) -> dict[str, Any]:
    contract, entry = call["call"].split(".")
    given = {name: from_json(call.get(name, to_json(value))) for name, value in _CONTEXT.items()}
    host = CallHost(state)
    outcome = invoke(
        contracts,
        contract,
        entry,
        from_json(call.get("args", [])),
        host=host,
        context=CallContext(**given),
        gas_limit=call.get("gas_limit", GAS_DEFAULT),
        mode=call.get("mode", "export"),
    )
    found: dict[str, Any] = {"code": outcome.code, "gas": outcome.gas_used}
    if not outcome.ok:
        return {**found, "message": outcome.message, "line": outcome.line}
    host.keep()
    writes = dict(host.writes)
    state.apply(writes)
    if outcome.result is not None:
        found["result"] = to_json(outcome.result)
    if writes:
        found["writes"] = {key.hex(): None if data is None else _stored(data) for key, data in sorted(writes.items())}
        found["root"] = state.state_root.hex()
    if outcome.events:
        found["events"] = [[name, event, to_json(decode_value(data))] for name, event, data in outcome.events]
    return found


def _stored(data: bytes) -> dict[str, Any]:
    return {"value": to_json(decode_value(data))}


def _play_refused(case: dict[str, Any]) -> dict[str, Any]:
    try:
        compile_contract(case["source"], "it")
    except ContractSourceError as error:
        one = error.verdict
        return {**case, "verdict": [one.code, one.line, one.column, one.message]}
    return {**case, "verdict": None}


def read_vectors(folder: Path) -> dict[str, dict[str, Any]]:
    """By file name. Raises VECTORS_MISSING."""
    documents = {path.name: read_json_text(path.read_text("utf-8")) for path in sorted(folder.glob("*.json"))}
    if not documents:
        raise BlockRobotError("VECTORS_MISSING", f"There are no vectors in {folder}.")
    return documents


def write_vectors(documents: dict[str, dict[str, Any]], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, document in documents.items():
        (folder / name).write_text(_render(document), encoding="utf-8")


def _render(document: dict[str, Any]) -> str:
    parts = []
    for key, value in document.items():
        if key in ("calls", "refused") and value:
            rows = ",\n".join("    " + json.dumps(row) for row in value)
            parts.append(f'  "{key}": [\n{rows}\n  ]')
        else:
            text = json.dumps(value, indent=2) if key == "contracts" else json.dumps(value, ensure_ascii=False)
            parts.append(f'  "{key}": ' + text.replace("\n", "\n  "))
    return "{\n" + ",\n".join(parts) + "\n}\n"


def count(document: dict[str, Any]) -> int:
    return len(document.get("calls", [])) + len(document.get("refused", []))


def compare(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    found = play(document)
    if document.get("language") != LANGUAGE_VERSION:
        yield {"call": "language", "expected": document.get("language"), "found": LANGUAGE_VERSION}
    for place, (old, new) in enumerate(zip(document.get("calls", []), found["calls"], strict=True)):
        if old.get("outcome") != new["outcome"]:
            yield {"call": f"{place} {old['call']}", "expected": old.get("outcome"), "found": new["outcome"]}
    for place, (old, new) in enumerate(zip(document.get("refused", []), found["refused"], strict=True)):
        if old.get("verdict") != new["verdict"]:
            yield {"call": f"refused {place}", "expected": old.get("verdict"), "found": new["verdict"]}
