"""Contract changes and migrations at the start of a block.

One activation or disabling per block, decided only by the machine's own table, sources and trials, so a faulty
`lifecycle` cannot corrupt them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.state.keys import Reader
from consensus.state.lifecycle import DUE, MACHINE_TABLE, MACHINE_TRIALS, TABLE, TRIALS, VERSION
from consensus.state.producers import EPOCH
from contracts.execution.call_host import CallHost
from contracts.execution.results import IN_CHANGE, BlockContext, ExecutionFault, note_nothing
from contracts.lifecycle.catalogue import (
    ActiveContracts,
    Catalogue,
    find_source,
    keep_source,
)
from contracts.lifecycle.changes import (
    GOVERNING,
    TRIAL_MS,
    Row,
    read_due,
    read_record,
    read_trials,
    read_value,
)
from contracts.vm import CallContext, CompiledContract, ContractSourceError, InternalFault, invoke
from contracts.vm.compiler.compile_cache import compile_once

MIGRATION_GAS_MAX = 2_000_000
_NOBODY = bytes(33)
_NO_TRANSACTION = bytes(32)
_GIVEN_UP = (
    "EXHAUSTED: Too few nodes could put this version into force: it asks for more than they have, or they failed."
)

Table = dict[str, list[Any]]


def find_activation(state: Reader, height: int, time_ms: int) -> tuple[str, int] | None:
    """Return name and version that a block of this height and time activates, or None.

    Only activations can be given up (R42).
    """
    ready = (row for row in read_due(state) if row["from_height"] <= height and row["from_ms"] <= time_ms)
    row = next((row for row in ready if row["kind"] != "keep"), None)
    return None if row is None or row["kind"] != "activate" else (row["name"], row["version"])


def open_block(
    host: CallHost,
    catalogue: Catalogue,
    context: BlockContext,
    *,
    gives_up: bool = False,
    note: Callable[[int], None] = note_nothing,
) -> ActiveContracts:
    """Apply due changes on the host; return the contracts of this block.

    With `gives_up` the due version fails unexecuted. Raises BLOCK_INVALID if none is due, ExecutionFault if the
    interpreter fails.
    """
    if gives_up and find_activation(host, context.height, context.time_ms) is None:
        raise BlockRobotError("BLOCK_INVALID", "The block gives up a change of contracts, and none is due.")
    due = read_due(host)
    ready = [row for row in due if _is_ready(row, context)]
    keeps = [row for row in ready if row["kind"] == "keep"]
    changes = [row for row in ready if row["kind"] != "keep"][:1]
    if ready:
        host.begin()
        _put(host, DUE.flat, [row for row in due if row not in keeps and row not in changes])
        host.keep()
    for row in keeps:
        _keep_version(host, row)
    ended = [row for row in read_trials(host) if _is_ready(row, context)]
    for row in ended:
        _return(host, context, row)
    for row in changes:
        note(IN_CHANGE)
        if gives_up:
            _fail(host, context, row["name"], row["version"], _GIVEN_UP)
            continue
        try:
            _take_effect(host, catalogue, context, row)
        except (InternalFault, MemoryError, RecursionError, SystemError) as error:
            raise ExecutionFault(f"{type(error).__name__}: {error}", in_change=True) from error
    if ready or ended:
        _show(host)
    return catalogue.active(host)


def _is_ready(row: Row, context: BlockContext) -> bool:
    return bool(row["from_height"] <= context.height and row["from_ms"] <= context.time_ms)


def _put(host: CallHost, key: bytes, value: Any) -> None:
    host.put(key, encode_value(value))


def _show(host: CallHost) -> None:
    """Copy table and trials to where `lifecycle` reads them; drop malformed pending rows."""
    host.begin()
    _put(host, TABLE.flat, read_value(host, MACHINE_TABLE.flat))
    _put(host, TRIALS.flat, read_trials(host))
    _put(host, DUE.flat, read_due(host))
    host.keep()


def _change_version(host: CallHost, name: str, version: int, change: Callable[[Row], None]) -> None:
    record = read_record(host, name, version)
    if record is not None:
        change(record)
        _put(host, VERSION.key(name, version), record)


def _mark(host: CallHost, name: str, version: int, status: str, height: int) -> None:
    _change_version(host, name, version, lambda record: record.update(status=status, since_height=height))


def _take_effect(host: CallHost, catalogue: Catalogue, context: BlockContext, row: Row) -> None:
    name, version = row["name"], row["version"]
    table: Table = read_value(host, MACHINE_TABLE.flat)
    before = table.get(name)
    host.begin()
    if row["kind"] == "disable":
        if before is not None and name not in GOVERNING:
            table[name] = [before[0], before[1], False, context.height]
            _put(host, MACHINE_TABLE.flat, table)
            _mark(host, name, before[0], "disabled", context.height)
        host.keep()
        return
    record = read_record(host, name, version)
    if record is None:
        return
    source_hash = record["source_hash"]
    if before is None or before[:2] != [version, source_hash]:
        failure = _prepare(host, catalogue, context, name, source_hash)
        if failure:
            _fail(host, context, name, version, failure)
            return
    _put_in_force(host, context, name, version, source_hash)
    if name in GOVERNING and before is not None:
        _set_trial(host, context, name, [version, source_hash], before)
    host.keep()


def _fail(host: CallHost, context: BlockContext, name: str, version: int, failure: str) -> None:
    fields = {"status": "failed", "since_height": context.height, "failure": failure}
    host.begin()
    _change_version(host, name, version, lambda record: record.update(fields))
    host.keep()


def _put_in_force(host: CallHost, context: BlockContext, name: str, version: int, source_hash: bytes) -> None:
    table: Table = read_value(host, MACHINE_TABLE.flat)
    before = table.get(name)
    if before is not None and before[0] != version:
        _mark(host, name, before[0], "superseded", context.height)
    table[name] = [version, source_hash, True, context.height]
    _put(host, MACHINE_TABLE.flat, table)
    _mark(host, name, version, "active", context.height)


def _prepare(host: CallHost, catalogue: Catalogue, context: BlockContext, name: str, source_hash: bytes) -> str:
    source = find_source(host, source_hash)
    if source is None:
        return "SOURCE_MISSING: The chain has no such source."
    try:
        compiled = compile_once(source, name)
    except ContractSourceError:
        return "SOURCE_INVALID: The source is not in the contract language."
    entry = next((entry.name for entry in compiled.abi.entries if entry.kind == "migrate"), None)
    if entry is not None and name in GOVERNING:
        return "MIGRATION_REFUSED: A contract that governs cannot migrate: it must be undoable."
    failure = "" if entry is None else _migrate(host, catalogue, context, name, compiled, entry)
    if not failure:
        keep_source(host, source, source_hash)
    return failure


def _migrate(
    host: CallHost, catalogue: Catalogue, context: BlockContext, name: str, compiled: CompiledContract, entry: str
) -> str:
    call = CallContext(
        caller=_NOBODY,
        height=context.height,
        time_ms=context.time_ms,
        txid=_NO_TRANSACTION,
        chain_id=context.chain_id,
    )
    epoch = host.get(EPOCH.flat)
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
    if outcome.ok and host.get(EPOCH.flat) != epoch:
        # The block may be one that closes an epoch: no other can begin there.
        return "MIGRATION_REFUSED: A migration cannot change the producers or the settings."
    if outcome.ok:
        return ""
    place = "" if outcome.line is None else f" (line {outcome.line})"
    return f"{outcome.code}: {outcome.message}{place}"


# Trials of contracts that govern


def _set_trial(host: CallHost, context: BlockContext, name: str, now: list[Any], before: list[Any]) -> None:
    """Schedule the return of the last kept version, unless it is active."""
    trials = read_trials(host)
    kept = next(([row["version"], row["source_hash"]] for row in trials if row["name"] == name), before[:2])
    trials = [row for row in trials if row["name"] != name]
    if kept != now:
        row = {"kind": "return", "name": name, "version": kept[0], "source_hash": kept[1]}
        trials.append({**row, "from_height": 0, "from_ms": context.time_ms + TRIAL_MS})
    _put(host, MACHINE_TRIALS.flat, trials)


def _keep_version(host: CallHost, row: Row) -> None:
    """End the active version's trial; decisions about other versions have no effect."""
    table: Table = read_value(host, MACHINE_TABLE.flat)
    if row["name"] in table and table[row["name"]][0] == row["version"]:
        host.begin()
        _put(host, MACHINE_TRIALS.flat, [trial for trial in read_trials(host) if trial["name"] != row["name"]])
        host.keep()


def _return(host: CallHost, context: BlockContext, trial: Row) -> None:
    host.begin()
    _put(host, MACHINE_TRIALS.flat, [other for other in read_trials(host) if other["name"] != trial["name"]])
    _put_in_force(host, context, trial["name"], trial["version"], trial["source_hash"])
    host.keep()
