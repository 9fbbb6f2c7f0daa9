"""Ledger builtins: state, events, hashes, signatures, other contracts.

Every key is placed under the calling contract's own prefix; nothing else is readable.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

from consensus.errors import BlockRobotError
from consensus.limits import STATE_KEY_MAX_BYTES, STATE_VALUE_MAX_BYTES
from consensus.primitives import hashing, keys
from contracts.vm.builtins.builtins_table import Builtin
from contracts.vm.model.closures import CONTEXT_SLOTS, Code, read_slot
from contracts.vm.model.dict_shapes import encode_by_shape
from contracts.vm.model.faults import LIFECYCLE_ONLY, TYPE_ERROR, VALUE_ERROR, Fault
from contracts.vm.model.meter import EVENTS_MAX_COUNT, Runtime
from contracts.vm.model.values import (
    HEADER_BYTES,
    ITEM_BYTES,
    charge_decoded,
    encode_checked,
    encode_walked,
    need_bytes,
    need_int,
    need_str,
    read_stored,
    type_fault,
    type_name,
)

EVENT_DATA_MAX_BYTES = 8 * 1024
SCAN_MAX_COUNT = 256
TAG_MAX_CHARS = 64
_EVENT_NAME_MAX_CHARS = 64
_EVENT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,63}", re.ASCII)

GET_GAS = 15
HAS_GAS = 15
PUT_GAS = 120
DELETE_GAS = 120
SCAN_GAS = 120
SCAN_ITEM_GAS = 16
SCAN_WRITTEN_GAS = 1
EMIT_GAS = 50
HASH_GAS = 15
RECOVER_GAS = 680
"""Whatever comes of it: a signature that leads to no key is found out only after the same work."""

LIFECYCLE = "lifecycle"
SOURCE_PART_BYTE_GAS = 40
SOURCE_CHECK_BYTE_GAS = 3
SOURCE_CHECK_GAS = 2000
SOURCE_KEPT_GAS = 20_000
"""What must be left to keep the verdict, or nothing is compiled; it is not taken."""
PROBLEM_MAX_CHARS = 200
"""What may be kept of a source: so that what follows the compiling is bounded, and no call fails for it."""


@lru_cache(maxsize=256)
def _is_event_name(name: str) -> bool:
    return _EVENT_NAME.fullmatch(name) is not None


def _key_fault(key: Any) -> Fault:
    if type(key) is not bytes:
        return Fault(TYPE_ERROR, f"A state key is bytes, not {type_name(key)}.")
    return Fault(VALUE_ERROR, f"A state key has 1 to {STATE_KEY_MAX_BYTES} bytes, not {len(key)}.")


def _state_get(runtime: Runtime, key: Any, default: Any = None) -> Any:
    if type(key) is not bytes or not 0 < len(key) <= STATE_KEY_MAX_BYTES:
        raise _key_fault(key)
    runtime.gas -= GET_GAS
    if runtime.gas < 0:
        runtime.exhausted()
    data = runtime.host.get(runtime.prefix + key)
    if data is None:
        return default
    runtime.gas -= len(data) >> 8
    return read_stored(runtime, data)


def _state_has(runtime: Runtime, key: Any) -> bool:
    if type(key) is not bytes or not 0 < len(key) <= STATE_KEY_MAX_BYTES:
        raise _key_fault(key)
    runtime.gas -= HAS_GAS
    if runtime.gas < 0:
        runtime.exhausted()
    return runtime.host.get(runtime.prefix + key) is not None


def _state_put(runtime: Runtime, key: Any, value: Any) -> None:
    if type(key) is not bytes or not 0 < len(key) <= STATE_KEY_MAX_BYTES:
        raise _key_fault(key)
    if runtime.read_only or runtime.writes_left < 1:
        runtime.check_write()
    runtime.writes_left -= 1
    if type(value) is dict:
        data = encode_by_shape(runtime, value, STATE_VALUE_MAX_BYTES) or encode_walked(
            runtime, value, STATE_VALUE_MAX_BYTES, "A stored value"
        )
    else:
        data = encode_checked(runtime, value, STATE_VALUE_MAX_BYTES, "A stored value")
    runtime.gas -= PUT_GAS + (len(key) + len(data) >> 3)
    if runtime.gas < 0:
        runtime.exhausted()
    runtime.host.put(runtime.prefix + key, data)


def _state_delete(runtime: Runtime, key: Any) -> None:
    if type(key) is not bytes or not 0 < len(key) <= STATE_KEY_MAX_BYTES:
        raise _key_fault(key)
    runtime.check_write()
    runtime.charge(DELETE_GAS)
    runtime.host.delete(runtime.prefix + key)


def _state_scan(runtime: Runtime, prefix: Any, limit: Any) -> list[Any]:
    if len(need_bytes(prefix, "state.scan")) > STATE_KEY_MAX_BYTES:
        raise _key_fault(prefix)
    if not 0 < need_int(limit, "state.scan") <= SCAN_MAX_COUNT:
        raise Fault(VALUE_ERROR, f"A scan returns 1 to {SCAN_MAX_COUNT} entries.")
    runtime.charge(SCAN_GAS + SCAN_WRITTEN_GAS * (runtime.writes_max - runtime.writes_left))
    skipped = len(runtime.prefix)
    found: list[Any] = []
    for key, data in runtime.host.scan(runtime.prefix + prefix, limit):
        runtime.charge(SCAN_ITEM_GAS + (len(data) >> 8))
        runtime.allocate(2 * HEADER_BYTES + 3 * ITEM_BYTES + len(key))
        found.append([key[skipped:], read_stored(runtime, data)])
    return found


def _emit(runtime: Runtime, name: Any, data: Any) -> None:
    if len(need_str(name, "emit")) > _EVENT_NAME_MAX_CHARS or not _is_event_name(name):
        raise Fault(VALUE_ERROR, "An event's name is 1 to 64 ASCII letters, digits, '_', '.' or '-', a letter first.")
    if type(data) is not dict:
        raise Fault(TYPE_ERROR, f"An event's data is a dict, not {type_name(data)}.")
    if runtime.read_only or len(runtime.events) >= EVENTS_MAX_COUNT:
        runtime.check_event()
    encoded = encode_by_shape(runtime, data, EVENT_DATA_MAX_BYTES) or encode_walked(
        runtime, data, EVENT_DATA_MAX_BYTES, "An event's data"
    )
    runtime.gas -= EMIT_GAS + (len(name) + len(encoded) >> 4)
    if runtime.gas < 0:
        runtime.exhausted()
    runtime.events.append((runtime.contract, name, encoded))
    runtime.host.emit(name, encoded)


def _sha256(runtime: Runtime, data: Any) -> bytes:
    runtime.charge(HASH_GAS + (len(need_bytes(data, "sha256")) >> 6))
    runtime.allocate(HEADER_BYTES + 32)
    return hashing.sha256(data)


def _check_tag(tag: Any, what: str) -> str:
    need_str(tag, what)
    if not 0 < len(tag) <= TAG_MAX_CHARS or not tag.isascii():
        raise Fault(VALUE_ERROR, f"A tag is 1 to {TAG_MAX_CHARS} ASCII characters.")
    return str(tag)


def _tagged_hash(runtime: Runtime, tag: Any, data: Any) -> bytes:
    _check_tag(tag, "tagged_hash")
    runtime.charge(2 * HASH_GAS + (len(need_bytes(data, "tagged_hash")) >> 6))
    runtime.allocate(HEADER_BYTES + 32)
    return hashing.tagged_hash(tag, data)


def _recover(runtime: Runtime, tag: Any, signature: Any, message: Any) -> bytes | None:
    _check_tag(tag, "recover")
    need_bytes(signature, "recover")
    runtime.charge(RECOVER_GAS + (len(need_bytes(message, "recover")) >> 6))
    runtime.allocate(HEADER_BYTES + 33)
    try:
        return keys.recover(tag, signature, message)
    except BlockRobotError:
        return None


def _call(runtime: Runtime, contract: Any, fn: Any, *arguments: Any) -> Any:
    if type(contract) is not str or type(fn) is not str:
        raise type_fault("call", fn if type(contract) is str else contract)
    return runtime.enter(runtime, contract, fn, [*arguments])


def _require_lifecycle(runtime: Runtime, what: str) -> None:
    if runtime.contract != LIFECYCLE:
        raise Fault(LIFECYCLE_ONLY, f"Only the contract {LIFECYCLE} may use {what}.")


def _charge_source(runtime: Runtime, data: Any) -> None:
    _require_lifecycle(runtime, "charge_source")
    runtime.charge(SOURCE_PART_BYTE_GAS * len(need_bytes(data, "charge_source")))


def _check_source(runtime: Runtime, data: Any) -> list[Any]:
    """Return [problem or empty text, facts]; kept as a result, so it depends on no version of Python."""
    _require_lifecycle(runtime, "check_source")
    price = SOURCE_CHECK_GAS + SOURCE_CHECK_BYTE_GAS * len(need_bytes(data, "check_source"))
    runtime.charge(price + SOURCE_KEPT_GAS)
    runtime.gas += SOURCE_KEPT_GAS
    problem, facts = runtime.judge_source(data)
    problem = problem.encode("ascii", "backslashreplace").decode()
    if len(problem) > PROBLEM_MAX_CHARS:
        problem = problem[: PROBLEM_MAX_CHARS - 3] + "..."
    charge_decoded(runtime, [problem, facts])
    return [problem, facts]


HOST_FUNCTIONS: dict[str, Builtin] = {
    "state.get": Builtin(_state_get, ("key", "default"), 1),
    "state.has": Builtin(_state_has, ("key",), 1),
    "state.put": Builtin(_state_put, ("key", "value"), 2),
    "state.delete": Builtin(_state_delete, ("key",), 1),
    "state.scan": Builtin(_state_scan, ("prefix", "limit"), 2),
    "emit": Builtin(_emit, ("name", "data"), 2),
    "call": Builtin(_call, ("contract", "fn"), 2, variadic=True),
    "sha256": Builtin(_sha256, ("data",), 1),
    "tagged_hash": Builtin(_tagged_hash, ("tag", "data"), 2),
    "recover": Builtin(_recover, ("tag", "signature", "message"), 3),
    "charge_source": Builtin(_charge_source, ("data",), 1),
    "check_source": Builtin(_check_source, ("data",), 1),
}
CONTEXT_FIELDS: dict[str, Code] = {
    **{name: read_slot(slot) for name, slot in CONTEXT_SLOTS.items()},
    "contract": Code(lambda frame: frame[0].contract),
    "calling_contract": Code(lambda frame: frame[0].calling_contract),
}
"""What `ctx.<name>` reads."""
WRITING = frozenset({"state.put", "state.delete", "emit"})
