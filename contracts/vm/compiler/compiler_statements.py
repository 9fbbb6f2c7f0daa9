"""Compiles checked statements and whole functions.

Closures return None or one of three signals. Each block charges its static cost on entry, without nested blocks.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from typing import Any, Final

from contracts.vm.builtins.builtins_table import require_fault
from contracts.vm.builtins.operations import BINARY, delete_item, get_item, iterate, set_item
from contracts.vm.compiler.compiler_expressions import (
    FUNCTION_GAS,
    SLOTS_SHIFT,
    UNPACKED_GAS,
    ExpressionCompiler,
    FunctionCode,
    Scope,
    bind_many,
)
from contracts.vm.compiler.line_watch import Place, Watch, watched
from contracts.vm.frontend.name_binding import CALLABLES, Bound, FunctionFacts, bind, dotted_name
from contracts.vm.model.closures import RESULT_SLOT, Code, Frame, Run
from contracts.vm.model.faults import OUT_OF_GAS, Fault
from contracts.vm.model.values import MISSING, Mark

RETURN: Final = Mark("return")
BREAK: Final = Mark("break")
CONTINUE: Final = Mark("continue")
LOOP_STEP_GAS = 1
LOOP_GAS = 1
ITEM_STORE_GAS = 2
ITEM_UPDATE_GAS = 5
FRAMES_PER_CALL = 12
SLOTS_PER_FRAME = 32
_PLAIN_STATEMENTS = (ast.Assign, ast.AnnAssign, ast.AugAssign, ast.Expr, ast.Delete)


class StatementCompiler(ExpressionCompiler):
    """Compiles one function's statements, reporting each to `watch` if present."""

    watch: Watch | None = None
    function_name = ""

    def block(self, body: list[ast.stmt], extra_cost: int = 0, *, is_function: bool = False) -> tuple[Run, bool]:
        outer_cost, self.cost = self.cost, extra_cost
        steps: list[Run] = []
        lines: dict[Run, int] = {}
        leaves = False
        plain_count = 0
        for group in self._groups(body):
            statement, before = group[0], self.cost
            self.cost += len(group)
            step, leaves_here = (self._require(group), False) if _is_require(statement) else self._statement(statement)
            leaves = leaves or leaves_here
            if step is not None:
                if plain_count == len(steps) and isinstance(statement, _PLAIN_STATEMENTS):
                    plain_count += 1
                elif isinstance(statement, ast.Expr):
                    step = _without_value(step)
                if self.watch is not None:
                    place = Place(self.function_name, statement.lineno, self.cost - before, self.scope.slots)
                    step = watched(step, place, self.watch)
                steps.append(step)
                lines[step] = statement.lineno
        if is_function:
            self.cost += len(self.scope.initial) >> SLOTS_SHIFT
        run = _run_block(steps, plain_count, lines, self.cost, body[0].lineno)
        self.cost = outer_cost
        return run, leaves

    def _groups(self, body: list[ast.stmt]) -> Iterator[list[ast.stmt]]:
        requirements: list[ast.stmt] = []
        for statement in body:
            if _is_require(statement) and self.watch is None:
                requirements.append(statement)
                continue
            if requirements:
                yield requirements
                requirements = []
            if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
                yield [statement]
        if requirements:
            yield requirements

    def _statement(self, node: ast.stmt) -> tuple[Run | None, bool]:  # noqa: PLR0911 - one per node type
        match node:
            case ast.Assign():
                return self._store(node.targets[0], self.expression(node.value)), False
            case ast.AnnAssign():
                assert node.value is not None
                return self._store(node.target, self.expression(node.value)), False
            case ast.AugAssign():
                return self._augmented(node), False
            case ast.Expr():
                return self.expression(node.value).run, False
            case ast.Return():
                return self._return(node), True
            case ast.If():
                return self._if(node)
            case ast.While():
                return self._while(node), False
            case ast.For():
                return self._for(node), False
            case ast.Break():
                return _fixed(BREAK), True
            case ast.Continue():
                return _fixed(CONTINUE), True
            case ast.Delete():
                return self._delete(node), False
        return None, False

    def _store(self, target: ast.expr, value: Code) -> Run:
        run = value.run
        if isinstance(target, ast.Name):
            slot = self.scope.slots[target.id]
            self.scope.definite.add(slot)

            def store(frame: Frame) -> None:
                frame[slot] = run(frame)

            return store
        if isinstance(target, ast.Subscript):
            container, key = self.expression(target.value).run, self.expression(target.slice).run
            self.cost += ITEM_STORE_GAS

            def store_item(frame: Frame) -> None:
                item = run(frame)
                set_item(frame[0], container(frame), key(frame), item)

            return store_item
        bind_items = self._unpacking(target)
        self.cost += UNPACKED_GAS * len(target.elts) if isinstance(target, ast.Tuple | ast.List) else 0

        def store_many(frame: Frame) -> None:
            bind_items(frame, run(frame))

        return store_many

    def _unpacking(self, target: ast.expr) -> Callable[[Frame, Any], None]:
        assert isinstance(target, ast.Tuple | ast.List)
        slots = [self.scope.slots[element.id] for element in target.elts if isinstance(element, ast.Name)]
        self.scope.definite.update(slots)
        return bind_many(slots)

    def _augmented(self, node: ast.AugAssign) -> Run:
        operation = BINARY[type(node.op).__name__]
        if isinstance(node.target, ast.Name):
            slot = self.scope.slots[node.target.id]
            old = self.expression(ast.Name(node.target.id, ast.Load())).run
            value = self.expression(node.value).run

            def update(frame: Frame) -> None:
                before = old(frame)
                frame[slot] = operation(frame[0], before, value(frame))

            return update
        assert isinstance(node.target, ast.Subscript)
        container, key = self.expression(node.target.value).run, self.expression(node.target.slice).run
        value = self.expression(node.value).run
        self.cost += ITEM_UPDATE_GAS

        def update_item(frame: Frame) -> None:
            runtime, whole, place = frame[0], container(frame), key(frame)
            before = get_item(runtime, whole, place)
            set_item(runtime, whole, place, operation(runtime, before, value(frame)))

        return update_item

    def _require(self, statements: list[ast.stmt]) -> Run:
        tests: list[tuple[Run, Run]] = []
        lines: dict[Run, int] = {}
        for statement in statements:
            assert isinstance(statement, ast.Expr)
            assert isinstance(statement.value, ast.Call)
            bound = bind(CALLABLES["require"].params, 2, statement.value)
            assert isinstance(bound, Bound)
            parts = [self.expression(part).run for part in bound.arguments if part is not None]
            refuse = _refusal(parts[1], parts[2] if len(parts) > 2 else None)
            tests.append((parts[0], refuse))
            lines[refuse] = statement.lineno

        def require(frame: Frame) -> None:
            refuse = None
            try:
                for condition, refuse in tests:
                    if not condition(frame):
                        raise refuse(frame)
            except Fault as fault:
                if fault.line is None and refuse is not None:
                    fault.line = lines[refuse]
                raise

        return require

    def _return(self, node: ast.Return) -> Run:
        if node.value is None:
            return _fixed(RETURN)
        run = self.expression(node.value).run

        def leave(frame: Frame) -> Mark:
            frame[RESULT_SLOT] = run(frame)
            return RETURN

        return leave

    def _if(self, node: ast.If) -> tuple[Run, bool]:
        branches: list[tuple[Run, Run]] = []
        known: list[set[int]] = []
        every_leaves = True
        rest: list[ast.stmt] = [node]
        while len(rest) == 1 and isinstance(rest[0], ast.If):
            part = rest[0]
            test = self.expression(part.test).run
            before = set(self.scope.definite)
            body, leaves = self.block(part.body)
            if not leaves:
                known.append(self.scope.definite)
            every_leaves = every_leaves and leaves
            self.scope.definite = before
            branches.append((test, body))
            rest = part.orelse
        otherwise: Run | None = None
        if rest:
            before = set(self.scope.definite)
            otherwise, leaves = self.block(rest)
            every_leaves = every_leaves and leaves
        else:
            leaves = every_leaves = False
        if not leaves:
            known.append(self.scope.definite)
        self.scope.definite = set.intersection(*known) if known else before
        return _choose(branches, otherwise), every_leaves

    def _while(self, node: ast.While) -> Run:
        outer_cost, self.cost = self.cost, LOOP_STEP_GAS
        before = set(self.scope.definite)
        test = self.expression(node.test).run
        step_cost, self.cost = self.cost, outer_cost
        body, _ = self.block(node.body)
        self.scope.definite = before

        def loop(frame: Frame) -> Any:
            runtime = frame[0]
            while True:
                runtime.gas -= step_cost
                if runtime.gas < 0:
                    runtime.exhausted()
                if not test(frame):
                    return None
                signal = body(frame)
                if signal is not None:
                    if signal is BREAK:
                        return None
                    if signal is RETURN:
                        return RETURN

        return loop

    def _for(self, node: ast.For) -> Run:
        self.cost += LOOP_GAS
        source = self.expression(node.iter).run
        before = set(self.scope.definite)
        if isinstance(node.target, ast.Name):
            slot = self.scope.slots[node.target.id]
            self.scope.definite.add(slot)
            body, _ = self.block(node.body, LOOP_STEP_GAS)
            run = _for_one(source, slot, body)
        else:
            bind_items = self._unpacking(node.target)
            assert isinstance(node.target, ast.Tuple | ast.List)
            body, _ = self.block(node.body, LOOP_STEP_GAS + UNPACKED_GAS * len(node.target.elts))
            run = _for_many(source, bind_items, body)
        self.scope.definite = before
        return run

    def _delete(self, node: ast.Delete) -> Run:
        pairs: list[tuple[Run, Run]] = []
        for target in node.targets:
            assert isinstance(target, ast.Subscript)
            pairs.append((self.expression(target.value).run, self.expression(target.slice).run))

        def delete(frame: Frame) -> None:
            for container, key in pairs:
                delete_item(frame[0], container(frame), key(frame))

        return delete


def _is_require(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and dotted_name(node.value.func) == "require"


def _refusal(code: Run, message: Run | None) -> Run:
    return lambda frame: require_fault(code(frame), MISSING if message is None else message(frame))


def _without_value(step: Run) -> Run:
    def run(frame: Frame) -> None:
        step(frame)

    return run


def _fixed(signal: Mark) -> Run:
    def run(frame: Frame) -> Mark:  # noqa: ARG001 - a statement takes the frame
        return signal

    return run


def _choose(branches: list[tuple[Run, Run]], otherwise: Run | None) -> Run:
    if len(branches) == 1:
        test, body = branches[0]
        if otherwise is None:
            return lambda frame: body(frame) if test(frame) else None
        return lambda frame: body(frame) if test(frame) else otherwise(frame)

    def run(frame: Frame) -> Any:
        for test, body in branches:
            if test(frame):
                return body(frame)
        return None if otherwise is None else otherwise(frame)

    return run


def _for_one(source: Run, slot: int, body: Run) -> Run:
    def loop(frame: Frame) -> Any:
        for item in iterate(frame[0], source(frame)):
            frame[slot] = item
            signal = body(frame)
            if signal is not None:
                if signal is BREAK:
                    return None
                if signal is RETURN:
                    return RETURN
        return None

    return loop


def _for_many(source: Run, bind_items: Callable[[Frame, Any], None], body: Run) -> Run:
    def loop(frame: Frame) -> Any:
        for item in iterate(frame[0], source(frame)):
            bind_items(frame, item)
            signal = body(frame)
            if signal is not None:
                if signal is BREAK:
                    return None
                if signal is RETURN:
                    return RETURN
        return None

    return loop


def _run_block(steps: list[Run], plain_count: int, lines: dict[Run, int], cost: int, first_line: int) -> Run:
    plain, others = steps[:plain_count], steps[plain_count:]
    if len(steps) == 1 and not plain:
        only, line = steps[0], lines[steps[0]]

        def run_one(frame: Frame) -> Any:
            runtime = frame[0]
            runtime.gas -= cost
            if runtime.gas < 0:
                raise Fault(OUT_OF_GAS, "The call used up its gas.", first_line)
            try:
                return only(frame)
            except Fault as fault:
                if fault.line is None:
                    fault.line = line
                raise

        return run_one

    def run_plain(frame: Frame) -> None:
        runtime = frame[0]
        runtime.gas -= cost
        if runtime.gas < 0:
            raise Fault(OUT_OF_GAS, "The call used up its gas.", first_line)
        step = None
        try:
            for step in plain:
                step(frame)
        except Fault as fault:
            if fault.line is None and step is not None:
                fault.line = lines[step]
            raise

    def run(frame: Frame) -> Any:
        runtime = frame[0]
        runtime.gas -= cost
        if runtime.gas < 0:
            raise Fault(OUT_OF_GAS, "The call used up its gas.", first_line)
        step = None
        try:
            for step in plain:
                step(frame)
            for step in others:
                signal = step(frame)
                if signal is not None:
                    return signal
        except Fault as fault:
            if fault.line is None and step is not None:
                fault.line = lines[step]
            raise
        return None

    return run if others else run_plain


def nesting(node: ast.AST) -> int:
    """Return a function's nesting depth; elif chains count as one level."""
    if isinstance(node, ast.If) and len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
        here = 1 + max(nesting(child) for child in [node.test, *node.body])
        return max(here, nesting(node.orelse[0]))
    return 1 + max((nesting(child) for child in ast.iter_child_nodes(node)), default=0)


def compile_function(
    facts: FunctionFacts,
    function: FunctionCode,
    constants: dict[str, Any],
    functions: dict[str, FunctionFacts],
    codes: dict[str, FunctionCode],
    defaults: dict[str, list[Any]],
    watch: Watch | None = None,
) -> None:
    scope = Scope(facts)
    compiler = StatementCompiler(constants, functions, codes, defaults, scope)
    compiler.watch, compiler.function_name = watch, facts.node.name
    function.body, _ = compiler.block(facts.node.body, FUNCTION_GAS, is_function=True)
    function.tail = scope.initial
    function.depth = 2 * nesting(facts.node) + FRAMES_PER_CALL + len(scope.initial) // SLOTS_PER_FRAME
