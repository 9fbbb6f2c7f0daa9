"""Predicts on-chain refusals of compiled sources, by the shipped contract `lifecycle`."""

from __future__ import annotations

import ast
from functools import cache
from typing import Any

from consensus.primitives.encoding import encode_value
from contracts.lifecycle.registry import read_source
from contracts.vm import CompiledContract, Diagnostic
from contracts.vm.compiler.compile_cache import FACTS_MAX_BYTES, describe_source


@cache
def read_limit(name: str) -> Any:
    for item in ast.parse(read_source("lifecycle")).body:
        if isinstance(item, ast.Assign) and isinstance(item.targets[0], ast.Name) and item.targets[0].id == name:
            return ast.literal_eval(item.value)
    raise AssertionError(f"lifecycle has no constant {name}")


def find_refusals(source: str, compiled: CompiledContract) -> tuple[Diagnostic, ...]:
    """Return why `lifecycle` would refuse a source; () if accepted."""
    name, entries = compiled.name, compiled.abi.entries
    found: list[Diagnostic] = []
    if name in read_limit("RESERVED_NAMES"):
        found.append(Diagnostic("CONTRACT_NAME", 1, 1, f"The name {name} is reserved.", "Choose another name."))
    facts = describe_source(source.encode(), compiled)
    called = [entry for entry in entries if entry.kind in ("export", "view")]
    most = read_limit("ENTRIES_MAX_COUNT")
    if len(called) > most:
        text = f"A contract has at most {most} entries; this one has {len(called)}."
        found.append(Diagnostic("ENTRIES_TOO_MANY", called[most].line, 1, text, "Split the contract."))
    if len(encode_value(facts)) > FACTS_MAX_BYTES:
        text = f"The names and types of a contract's entries take at most {FACTS_MAX_BYTES} bytes."
        found.append(Diagnostic("INTERFACE_TOO_LONG", 1, 1, text, "Shorten them, or split the contract."))
    if facts["migrates"] and name in read_limit("GOVERNING"):
        line = next(entry.line for entry in entries if entry.kind == "migrate")
        text = "A contract that governs cannot migrate: it must be undoable."
        found.append(Diagnostic("MIGRATION_REFUSED", line, 1, text, "Read what is there in its old form too."))
    return tuple(found)
