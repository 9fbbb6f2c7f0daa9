"""Source hashes and facts; compiles each source once, caching never changes outcomes."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

from consensus.primitives.encoding import encode_value
from consensus.primitives.hashing import tagged_hash
from consensus.state.keys import flat_prefix
from contracts.vm.compiler.compiled_contract import CompiledContract, compile_contract
from contracts.vm.frontend.abi import Abi
from contracts.vm.frontend.checker import check_name
from contracts.vm.model.faults import ContractSourceError, Diagnostic

SOURCE_TAG = "blockrobot/contract-source"
SOURCES_KEPT_COUNT = 64
FACTS_MAX_BYTES = 8 * 1024
"""What may be kept of a source, encoded."""
_NAMELESS = "contract"


def compute_source_hash(data: bytes) -> bytes:
    return tagged_hash(SOURCE_TAG, data)


@lru_cache(maxsize=SOURCES_KEPT_COUNT)
def _compile(source: str) -> CompiledContract | tuple[tuple[Diagnostic, ...], Diagnostic]:
    try:
        return compile_contract(source, _NAMELESS)
    except ContractSourceError as error:
        return error.diagnostics, error.verdict


def check_once(source: str) -> CompiledContract:
    """Namelessly, cached. Raises ContractSourceError."""
    outcome = _compile(source)
    if isinstance(outcome, CompiledContract):
        return outcome
    raise ContractSourceError(_NAMELESS, *outcome)


def compile_once(source: str, name: str) -> CompiledContract:
    """One compilation serves all names. Raises ContractSourceError."""
    check_name(name)
    found = check_once(source)
    return replace(found, name=name, abi=Abi(name, found.abi.entries), prefix=flat_prefix(name))


def describe_source(data: bytes, compiled: CompiledContract) -> dict[str, Any]:
    """Return {source_hash, size_bytes, entries, migrates} for `lifecycle`.

    An entry (export or view) is [name, kind, [[parameter, type]], required count, result type].
    """
    entries = compiled.abi.entries
    return {
        "source_hash": compute_source_hash(data),
        "size_bytes": len(data),
        "entries": [
            [entry.name, entry.kind, [list(param) for param in entry.params], entry.required, entry.returns]
            for entry in entries
            if entry.kind in ("export", "view")
        ],
        "migrates": any(entry.kind == "migrate" for entry in entries),
    }


def judge_source(data: bytes) -> tuple[str, dict[str, Any]]:
    """Its problem (empty if none) and facts ({} if refused)."""
    try:
        facts = describe_source(data, check_once(data.decode()))
    except UnicodeDecodeError:
        return "The source is not UTF-8.", {}
    except ContractSourceError as error:
        found = error.verdict
        return f"Line {found.line} of the source: {found.code}: {found.message}", {}
    if len(encode_value(facts)) > FACTS_MAX_BYTES:
        return f"The names and types of a contract's entries take at most {FACTS_MAX_BYTES} bytes.", {}
    return "", facts
