"""A compiled contract and its compilation; nothing of a call is kept."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import Any, get_args

from consensus.primitives.hashing import sha256
from consensus.state.keys import flat_prefix
from contracts.vm.builtins.operations import BINARY, UNARY
from contracts.vm.compiler.compiler_expressions import FunctionCode
from contracts.vm.compiler.compiler_statements import compile_function
from contracts.vm.compiler.line_watch import Watch
from contracts.vm.frontend.abi import Abi, Accepts, Entry, EntryKind, count_choices, parse_type, plain_types, type_text
from contracts.vm.frontend.checker import check_source, check_thoroughly
from contracts.vm.frontend.name_binding import FunctionFacts, SourceFacts
from contracts.vm.model.faults import ContractSourceError, Diagnostic, Fault
from contracts.vm.model.meter import CallContext, Runtime
from contracts.vm.model.values import DICT_ENTRY_BYTES, HEADER_BYTES, ITEM_BYTES, MISSING, check_dict_key

CONSTANT_GAS = 100_000
CONSTANTS_MAX_BYTES = 192 * 1024
_OF_CONSTANTS = (ast.BinOp, ast.UnaryOp, ast.Tuple, ast.List, ast.Dict, ast.Constant, ast.Name)
_OF_VALUES = (type(None), bool, int, str, bytes)
_NO_CONTEXT = CallContext(b"", 0, 0, b"", b"")


@dataclass(frozen=True, slots=True)
class CompiledEntry:
    """One entry ready to run: description, argument and result tests, code, defaults.

    `plain` are the parameter types if each is one plain type; `choices` count the `|` in parameter types and result.
    """

    entry: Entry
    accepts: tuple[Accepts, ...]
    plain: list[type] | None
    accepts_result: Accepts | None
    function: FunctionCode
    defaults: tuple[Any, ...]
    choices: tuple[int, int]


@dataclass(frozen=True, slots=True)
class CompiledContract:
    """A contract ready to run; `source_hash` is SHA-256 of the source's UTF-8 bytes."""

    name: str
    abi: Abi
    source_hash: bytes
    prefix: bytes
    entries: dict[str, CompiledEntry]


class _NoHost:
    def get(self, key: bytes) -> bytes | None:
        raise AssertionError(key)

    def put(self, key: bytes, value: bytes) -> None:
        raise AssertionError(key, value)

    def delete(self, key: bytes) -> None:
        raise AssertionError(key)

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        raise AssertionError(prefix, limit)

    def emit(self, name: str, data: bytes) -> None:
        raise AssertionError(name, data)


def _no_call(runtime: Runtime, contract: str, entry: str, arguments: list[Any]) -> Any:
    raise AssertionError(runtime.contract, contract, entry, arguments)


def _no_source(data: bytes) -> tuple[str, dict[str, Any]]:
    raise AssertionError(data)


def compile_contract(source: str, name: str, *, watch: Watch | None = None) -> CompiledContract:
    """Compile a source; a `watch` sees every statement (slow). Raises ContractSourceError with `diagnostics`."""
    facts = check_source(source, name)
    constants, defaults, problems = _compute_constants(facts)
    if problems:
        raise ContractSourceError(name, tuple(problems))
    codes = {key: FunctionCode(key, len(one.params)) for key, one in facts.functions.items()}
    for key, one in facts.functions.items():
        compile_function(one, codes[key], constants, facts.functions, codes, defaults, watch)
    entries = {key: _entry(one, codes[key], tuple(defaults[key])) for key, one in facts.functions.items() if one.kind}
    abi = Abi(name, tuple(one.entry for one in entries.values()))
    return CompiledContract(name, abi, sha256(source.encode()), flat_prefix(name), entries)


def _entry(facts: FunctionFacts, function: FunctionCode, defaults: tuple[Any, ...]) -> CompiledEntry:
    node = facts.node
    kind = next(kind for kind in get_args(EntryKind) if kind == facts.kind)
    params = tuple((argument.arg, type_text(argument.annotation)) for argument in node.args.args)
    accepts = [parse_type(argument.annotation) for argument in node.args.args]
    entry = Entry(node.name, kind, params, type_text(node.returns), facts.required, node.lineno)
    checked = tuple(test for test in accepts if test is not None)
    choices = sum(count_choices(argument.annotation) for argument in node.args.args), count_choices(node.returns)
    return CompiledEntry(entry, checked, plain_types(params), parse_type(node.returns), function, defaults, choices)


def find_problems(source: str, name: str) -> tuple[Diagnostic, ...]:
    """Return all problems in source order; much slower than compiling."""
    found, facts = check_thoroughly(source, name)
    _, _, problems = _compute_constants(facts)
    known = {(one.line, one.column) for one in found}
    more = [one for one in problems if (one.line, one.column) not in known]
    return tuple(sorted([*found, *more], key=lambda one: (one.line, one.column, one.code)))


def _compute_constants(
    facts: SourceFacts,
) -> tuple[dict[str, Any], dict[str, list[Any]], list[Diagnostic]]:
    runtime = Runtime(_NoHost(), _NO_CONTEXT, CONSTANT_GAS, _no_call, _no_source, read_only=True)
    runtime.memory = CONSTANTS_MAX_BYTES
    constants: dict[str, Any] = {}
    problems: list[Diagnostic] = []

    def compute(node: ast.expr) -> Any:
        try:
            if not _is_sound(node, constants):
                return MISSING
            value = _evaluate(node, constants, runtime)
            _charge_tree(runtime, value)
            return value
        except Fault as fault:
            message = f"This constant cannot be computed: {fault.message}"
            problems.append(Diagnostic("CONSTANT", node.lineno, node.col_offset + 1, message, "Change it."))
            return MISSING

    for key, node in facts.constants.items():
        value = MISSING if key in facts.doubtful else compute(node)
        if value is not MISSING:
            constants[key] = value
    defaults = {key: [compute(node) for node in one.node.args.defaults] for key, one in facts.functions.items()}
    return constants, defaults, problems


def _is_sound(node: ast.expr, constants: dict[str, Any]) -> bool:
    for part in ast.walk(node):
        if isinstance(part, ast.Name) and part.id not in constants:
            return False
        if isinstance(part, ast.expr) and not isinstance(part, _OF_CONSTANTS):
            return False
        if isinstance(part, ast.BinOp) and type(part.op).__name__ not in BINARY:
            return False
        if isinstance(part, ast.Dict) and None in part.keys:
            return False
        if isinstance(part, ast.Constant) and type(part.value) not in _OF_VALUES:
            return False
    return True


def _charge_tree(runtime: Runtime, root: Any) -> None:
    """Charge a constant's modelled size before any walk; shared parts count each time."""
    pending = [root]
    while pending:
        value = pending.pop()
        kind = type(value)
        if kind is list or kind is tuple:
            runtime.allocate(HEADER_BYTES + ITEM_BYTES * len(value))
            pending.extend(value)
        elif kind is dict:
            runtime.allocate(HEADER_BYTES + DICT_ENTRY_BYTES * len(value))
            pending.extend(value.values())
        elif kind is str or kind is bytes:
            runtime.allocate(len(value))


def _evaluate(node: ast.expr, constants: dict[str, Any], runtime: Runtime) -> Any:  # noqa: PLR0911 - one per node type
    runtime.charge(1)
    match node:
        case ast.Constant():
            return node.value
        case ast.Name():
            return constants[node.id]
        case ast.BinOp():
            left, right = _evaluate(node.left, constants, runtime), _evaluate(node.right, constants, runtime)
            return BINARY[type(node.op).__name__](runtime, left, right)
        case ast.UnaryOp():
            operand = _evaluate(node.operand, constants, runtime)
            return not operand if isinstance(node.op, ast.Not) else UNARY[type(node.op).__name__](runtime, operand)
        case ast.List():
            return [_evaluate(element, constants, runtime) for element in node.elts]
        case ast.Tuple():
            return tuple([_evaluate(element, constants, runtime) for element in node.elts])
        case ast.Dict():
            result: dict[Any, Any] = {}
            for key, value in zip(node.keys, node.values, strict=True):
                assert key is not None
                name = _evaluate(key, constants, runtime)
                check_dict_key(name)
                result[name] = _evaluate(value, constants, runtime)
            return result
    raise AssertionError(type(node).__name__)
