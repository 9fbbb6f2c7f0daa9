"""What a block does before its first transaction: contracts change, and carry their state over. Must never half do it.

The contract `lifecycle` says what is due; the machine does it, and writes down itself what came of it. So not even a
faulty version of `lifecycle` can keep the one before it from coming back.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from consensus.primitives.encoding import decode_value, encode_value, u32
from contracts.execution.call_host import CallHost
from contracts.execution.catalogue import TABLE_KEY, ActiveContracts, Catalogue, compile_named
from contracts.execution.epochs import EPOCH_KEY
from contracts.execution.results import BlockContext
from contracts.vm import CallContext, invoke

DUE_KEY = b"lifecycle\x00due"
VERSION_PREFIX = b"lifecycle\x00version/"
MIGRATION_GAS_MAX = 2_000_000
_NOBODY = bytes(33)
_NO_TRANSACTION = bytes(32)

Row = dict[str, Any]


def open_block(host: CallHost, catalogue: Catalogue, context: BlockContext) -> ActiveContracts:
    """Let what is due take effect on the host, and return the contracts that this block runs with."""
    data = host.get(DUE_KEY)
    if data is not None:
        due: list[Row] = decode_value(data)
        ready = [entry for entry in due if _is_ready(entry, context)]
        if ready:
            host.begin()
            _put(host, DUE_KEY, [entry for entry in due if entry not in ready])
            host.keep()
            for entry in ready:
                _take_effect(host, catalogue, context, entry)
    return catalogue.active(host)


def _is_ready(entry: Row, context: BlockContext) -> bool:
    return bool(entry["from_height"] <= context.height and entry["from_ms"] <= context.time_ms)


def _put(host: CallHost, key: bytes, value: Any) -> None:
    host.put(key, encode_value(value))


def _change_version(host: CallHost, name: str, version: int, change: Callable[[Row], None]) -> None:
    key = VERSION_PREFIX + name.encode() + b"/" + u32(version)
    data = host.get(key)
    if data is not None:
        record: Row = decode_value(data)
        change(record)
        _put(host, key, record)


def _take_effect(host: CallHost, catalogue: Catalogue, context: BlockContext, entry: Row) -> None:
    """Disable a contract, or put a version of it into force; if its migration fails only that is written down."""
    name, version = entry["name"], entry["version"]
    table: dict[str, list[Any]] = decode_value(host.get(TABLE_KEY) or b"")
    before = table.get(name)
    host.begin()
    if entry["kind"] == "disable":
        if before is not None:
            table[name] = [before[0], before[1], False, context.height]
            _put(host, TABLE_KEY, table)
            _change_version(host, name, before[0], lambda record: _mark(record, "disabled", context.height))
        host.keep()
        return
    record = decode_value(host.get(VERSION_PREFIX + name.encode() + b"/" + u32(version)) or b"")
    if before is None or before[0] != version:
        failure = _migrate(host, catalogue, context, name, record)
        if failure:
            host.begin()
            _change_version(host, name, version, lambda record: _fail(record, failure, context.height))
            host.keep()
            return
        if before is not None:
            _change_version(host, name, before[0], lambda record: _mark(record, "superseded", context.height))
    table[name] = [version, record["source_hash"], True, context.height]
    _put(host, TABLE_KEY, table)
    _change_version(host, name, version, lambda record: _mark(record, "active", context.height))
    _set_trial(host, context, entry, None if before is None else before[0])
    host.keep()


def _mark(record: Row, status: str, height: int) -> None:
    record["status"], record["since_height"] = status, height


def _fail(record: Row, failure: str, height: int) -> None:
    _mark(record, "failed", height)
    record["failure"] = failure


def _migrate(host: CallHost, catalogue: Catalogue, context: BlockContext, name: str, record: Row) -> str:
    """Run the version's migration, if it has one, on the call's writes. Return why it failed, or an empty text."""
    if not record["migrates"]:
        return ""
    compiled = compile_named(host, name, record["source_hash"])
    entry = next(entry.name for entry in compiled.abi.entries if entry.kind == "migrate")
    call = CallContext(
        caller=_NOBODY,
        height=context.height,
        time_ms=context.time_ms,
        txid=_NO_TRANSACTION,
        chain_id=context.chain_id,
    )
    epoch = host.get(EPOCH_KEY)
    outcome = invoke(
        {**catalogue.active(host), name: compiled},
        name,
        entry,
        [],
        host=host,
        context=call,
        gas_limit=MIGRATION_GAS_MAX,
        mode="migrate",
    )
    if outcome.ok and host.get(EPOCH_KEY) != epoch:
        # The block may be one that closes an epoch: no other can begin there.
        return "MIGRATION_REFUSED: A migration cannot change the producers or the settings."
    if outcome.ok:
        return ""
    place = "" if outcome.line is None else f" (line {outcome.line})"
    return f"{outcome.code}: {outcome.message}{place}"


def _set_trial(host: CallHost, context: BlockContext, entry: Row, former: int | None) -> None:
    """Have the version before return by itself if the organisations do not keep this one: see the contract."""
    name = entry["name"]
    due: list[Row] = decode_value(host.get(DUE_KEY) or encode_value([]))
    returns = [other for other in due if other["kind"] == "return" and other["name"] == name]
    kept = returns[0]["version"] if returns else former
    due = [other for other in due if other not in returns]
    if entry["trial_ms"] > 0 and kept is not None and kept != entry["version"]:
        due.append(
            {
                "kind": "return",
                "name": name,
                "version": kept,
                "from_height": 0,
                "from_ms": context.time_ms + entry["trial_ms"],
                "trial_ms": 0,
            }
        )
    _put(host, DUE_KEY, due)
