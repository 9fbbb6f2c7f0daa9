"""Contract changes and migrations at the start of a block.

One activation or disabling per block, decided only by the machine's own table, sources and trials, so a faulty
`lifecycle` cannot corrupt them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.state.keys import Reader
from consensus.state.lifecycle import (
    DUE,
    MACHINE_TABLE,
    MACHINE_TRIALS,
    TABLE,
    TRIALS,
    VERSION,
    ChangeRow,
    ContractRow,
    TableRow,
    TrialRow,
)
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
    read_due,
    read_record,
    read_trials,
)
from contracts.vm import CallContext, CompiledContract, ContractSourceError, InternalFault, invoke
from contracts.vm.compiler.compile_cache import compile_once

MIGRATION_GAS_MAX = 2_000_000
_NOBODY = bytes(33)
_NO_TRANSACTION = bytes(32)
_GIVEN_UP = (
    "EXHAUSTED: Too few nodes could put this version into force: it asks for more than they have, or they failed."
)


def find_activation(state: Reader, height: int, time_ms: int) -> tuple[str, int] | None:
    """Return name and version that a block of this height and time activates, or None.

    Only activations can be given up (R42).
    """
    ready = (due.row for due in read_due(state) if due.row.from_height <= height and due.row.from_ms <= time_ms)
    row = next((row for row in ready if row.kind != "keep"), None)
    return None if row is None or row.kind != "activate" else (row.name, row.version)


def apply_due_changes(
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
    ready = [each for each in due if _is_ready(each.row, context)]
    keeps = [each for each in ready if each.row.kind == "keep"]
    changes = [each for each in ready if each.row.kind != "keep"][:1]
    if ready:
        host.begin()
        _put(host, DUE.flat, [each.value for each in due if each not in keeps and each not in changes])
        host.keep()
    for row, _ in keeps:
        _keep_version(host, row)
    ended = [trial for trial in read_trials(host) if _is_ready(trial, context)]
    for trial in ended:
        _roll_back_trial(host, context, trial)
    for row, _ in changes:
        note(IN_CHANGE)
        if gives_up:
            _fail(host, context, row.name, row.version, _GIVEN_UP)
            continue
        try:
            _take_effect(host, catalogue, context, row)
        except (InternalFault, MemoryError, RecursionError, SystemError) as error:
            raise ExecutionFault(f"{type(error).__name__}: {error}", in_change=True) from error
    if ready or ended:
        _publish_tables(host)
    return catalogue.active(host)


def _is_ready(row: ChangeRow, context: BlockContext) -> bool:
    return row.from_height <= context.height and row.from_ms <= context.time_ms


def _put(host: CallHost, key: bytes, value: Any) -> None:
    host.put(key, encode_value(value))


def _publish_tables(host: CallHost) -> None:
    """Copy table and trials to where `lifecycle` reads them; drop malformed pending rows."""
    host.begin()
    host.put(TABLE.flat, TABLE.encode(_read_table(host)))
    host.put(TRIALS.flat, TRIALS.encode(read_trials(host)))
    _put(host, DUE.flat, [each.value for each in read_due(host)])
    host.keep()


def _read_table(state: Reader) -> TableRow:
    return MACHINE_TABLE.read(state) or {}


def _put_contract(host: CallHost, name: str, row: ContractRow) -> None:
    host.put(MACHINE_TABLE.flat, MACHINE_TABLE.encode({**_read_table(host), name: row}))


def _put_trials(host: CallHost, trials: list[TrialRow]) -> None:
    host.put(MACHINE_TRIALS.flat, MACHINE_TRIALS.encode(trials))


def _change_version(host: CallHost, name: str, version: int, **fields: Any) -> None:
    record = read_record(host, name, version)
    if record is not None:
        _put(host, VERSION.key(name, version), record | fields)


def _mark(host: CallHost, name: str, version: int, status: str, height: int) -> None:
    _change_version(host, name, version, status=status, since_height=height)


def _take_effect(host: CallHost, catalogue: Catalogue, context: BlockContext, row: ChangeRow) -> None:
    name, version = row.name, row.version
    before = _read_table(host).get(name)
    host.begin()
    if row.kind == "disable":
        if before is not None and name not in GOVERNING:
            _put_contract(host, name, replace(before, enabled=False, since_height=context.height))
            _mark(host, name, before.version, "disabled", context.height)
        host.keep()
        return
    record = read_record(host, name, version)
    if record is None:
        return
    source_hash = record["source_hash"]
    if before is None or (before.version, before.source_hash) != (version, source_hash):
        failure = _prepare(host, catalogue, context, name, source_hash)
        if failure:
            _fail(host, context, name, version, failure)
            return
    _put_in_force(host, context, name, version, source_hash)
    if name in GOVERNING and before is not None:
        _set_trial(host, context, name, (version, source_hash), before)
    host.keep()


def _fail(host: CallHost, context: BlockContext, name: str, version: int, failure: str) -> None:
    host.begin()
    _change_version(host, name, version, status="failed", since_height=context.height, failure=failure)
    host.keep()


def _put_in_force(host: CallHost, context: BlockContext, name: str, version: int, source_hash: bytes) -> None:
    before = _read_table(host).get(name)
    if before is not None and before.version != version:
        _mark(host, name, before.version, "superseded", context.height)
    _put_contract(host, name, ContractRow(version, source_hash, True, context.height))
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


def _set_trial(host: CallHost, context: BlockContext, name: str, now: tuple[int, bytes], before: ContractRow) -> None:
    """Schedule the return of the last kept version, unless it is active."""
    trials = read_trials(host)
    kept = next((trial for trial in trials if trial.name == name), before)
    trials = [trial for trial in trials if trial.name != name]
    if (kept.version, kept.source_hash) != now:
        trials.append(TrialRow("return", name, kept.version, 0, context.time_ms + TRIAL_MS, kept.source_hash))
    _put_trials(host, trials)


def _keep_version(host: CallHost, row: ChangeRow) -> None:
    """End the active version's trial; decisions about other versions have no effect."""
    active = _read_table(host).get(row.name)
    if active is not None and active.version == row.version:
        host.begin()
        _put_trials(host, [trial for trial in read_trials(host) if trial.name != row.name])
        host.keep()


def _roll_back_trial(host: CallHost, context: BlockContext, trial: TrialRow) -> None:
    host.begin()
    _put_trials(host, [other for other in read_trials(host) if other.name != trial.name])
    _put_in_force(host, context, trial.name, trial.version, trial.source_hash)
    host.keep()
