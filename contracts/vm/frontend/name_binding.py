"""Resolves names and calls from the source alone, for checker and compiler alike."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass, field

from contracts.vm.builtins.builtins_table import BUILTINS, TYPES, Builtin
from contracts.vm.builtins.host import HOST_FUNCTIONS
from contracts.vm.builtins.methods import METHODS, Method

CALLABLES: dict[str, Builtin] = {**BUILTINS, **HOST_FUNCTIONS}
NAMESPACES = frozenset({"ctx", "state"})
RESERVED = frozenset({name.split(".")[0] for name in CALLABLES}) | NAMESPACES | frozenset(TYPES) | {"isinstance"}
KINDS = ("export", "view", "genesis", "migrate")
ONLY_BY_NAME = frozenset({"reverse", "signed"})
BY_NAME: dict[str, tuple[str, ...]] = {
    "sorted": ("reverse",), "sort": ("reverse",), "enumerate": ("start",), "int.from_bytes": ("byteorder", "signed"),
    "to_bytes": ("length", "byteorder", "signed"), "u32": ("number",), "u64": ("number",),
    "require": ("condition", "code", "message"), **{name: one.params for name, one in HOST_FUNCTIONS.items()},
}  # fmt: skip
KIND_HELP = "Use @export, @view, @genesis or @migrate."


@dataclass(slots=True)
class FunctionFacts:
    """One function: node, kind ("" for a helper), names that its body binds and reaches."""

    node: ast.FunctionDef
    kind: str
    params: tuple[str, ...]
    local_names: frozenset[str]
    calls: set[str] = field(default_factory=set)
    writes: ast.Call | None = None

    @property
    def required(self) -> int:
        return len(self.params) - len(self.node.args.defaults)


@dataclass(slots=True)
class SourceFacts:
    """Constants in order and functions by name; `doubtful` constants are unsound."""

    constants: dict[str, ast.expr] = field(default_factory=dict)
    doubtful: set[str] = field(default_factory=set)
    functions: dict[str, FunctionFacts] = field(default_factory=dict)


def bound_names(body: Sequence[ast.stmt]) -> frozenset[str]:
    names: set[str] = set()
    pending: list[ast.AST] = list(body)
    while pending:
        node = pending.pop()
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        names.update(_bound_by_refused(node))
        if not isinstance(node, ast.ListComp | ast.DictComp | ast.GeneratorExp):
            pending.extend(ast.iter_child_nodes(node))
    return frozenset(names)


def _bound_by_refused(node: ast.AST) -> list[str]:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    if isinstance(node, ast.Import | ast.ImportFrom):
        return [(one.asname or one.name).split(".")[0] for one in node.names]
    if isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar):
        return [node.name] if node.name else []
    return []


def dotted_name(node: ast.expr) -> str | None:
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}"
    return None


@dataclass(frozen=True, slots=True)
class Bound:
    """Arguments by parameter; None stands for a default."""

    arguments: tuple[ast.expr | None, ...]


def bind(  # noqa: PLR0911 - each return is another way not to fit
    params: Sequence[str], required: int, call: ast.Call, *, variadic: bool = False
) -> Bound | str:
    """Match arguments to parameters; on mismatch return the problem as a sentence."""
    if variadic:
        if call.keywords:
            return "takes no arguments by name."
        if len(call.args) < required:
            return f"takes at least {required} arguments, not {len(call.args)}."
        return Bound(tuple(call.args))
    if len(call.args) > len(params):
        return f"takes at most {len(params)} arguments, not {len(call.args)}."
    slots: list[ast.expr | None] = [*call.args, *[None] * (len(params) - len(call.args))]
    last = -1
    for keyword in call.keywords:
        if keyword.arg is None:
            return "does not take '**'."
        if keyword.arg not in params:
            return f"has no parameter {keyword.arg}."
        place = list(params).index(keyword.arg)
        if slots[place] is not None:
            return f"gets {keyword.arg} twice."
        if place < last:
            return f"gets {keyword.arg} after {params[last]}: arguments come in the order of the parameters."
        slots[place] = keyword.value
        last = place
    missing = [name for name, given in zip(params[:required], slots, strict=False) if given is None]
    if missing:
        return f"lacks {', '.join(missing)}."
    while slots and slots[-1] is None:
        slots.pop()
    return Bound(tuple(slots))


def naming_problem(name: str, params: Sequence[str], call: ast.Call) -> str:
    """Return Python's objection to named or positional passing, or ""."""
    for place, param in enumerate(params[: len(call.args)]):
        if param in ONLY_BY_NAME:
            return f"takes {param} by name only, and gets {place + 1} arguments by place."
    for keyword in call.keywords:
        if keyword.arg is not None and keyword.arg in params and keyword.arg not in BY_NAME.get(name, ()):
            return f"does not take {keyword.arg} by name."
    return ""


def bind_method(name: str, call: ast.Call) -> dict[type, tuple[Method, Bound]] | str:
    fitting: dict[type, tuple[Method, Bound]] = {}
    problem = ""
    for kind, method in METHODS.get(name, {}).items():
        bound = bind(method.params, method.required, call)
        if isinstance(bound, str):
            problem = bound
        elif None in bound.arguments:
            problem = "must get its arguments in order, none left out."
        else:
            fitting[kind] = (method, bound)
    return fitting or problem
