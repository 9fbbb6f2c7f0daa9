"""Checks names, calls, operators and constants; callables never become values."""

from __future__ import annotations

import ast

from contracts.vm.builtins.builtins_table import TYPES
from contracts.vm.builtins.host import CONTEXT_FIELDS, WRITING
from contracts.vm.builtins.methods import METHODS
from contracts.vm.builtins.operations import BINARY, COMPARE
from contracts.vm.frontend.lexer_guard import WORDS
from contracts.vm.frontend.name_binding import (
    CALLABLES,
    RESERVED,
    FunctionFacts,
    SourceFacts,
    bind,
    bind_method,
    dotted_name,
    naming_problem,
)
from contracts.vm.model.faults import Diagnostic, is_author_code
from contracts.vm.model.values import INT_LIMIT

EXPRESSION_DEPTH_MAX = 60

_REFUSED: dict[str, tuple[str, str]] = {
    "Lambda": WORDS["lambda"],
    "Set": ("There are no sets.", "Use a list, or a dict with True as values."),
    "SetComp": ("There are no sets.", "Use a list, or a dict with True as values."),
    "GeneratorExp": ("A generator stands only as the one argument of a function.", "Use [ ... ]."),
    "NamedExpr": ("There is no ':='.", "Assign on a line of its own."),
    "Starred": ("There is no '*' here.", "Write the items out, or use '+'."),
    "Await": WORDS["await"],
    "Yield": WORDS["yield"],
    "YieldFrom": WORDS["yield"],
}
_BUILTIN_HINTS: dict[str, str] = {
    "print": "Use emit.", "open": "Keep data in the state.", "set": "Use a list or a dict.", "float": "Use ints.",
    "getattr": "Use a dict.", "eval": "Write the code out.", "exec": "Write the code out.", "hash": "Use sha256.",
    "type": "Use isinstance.", "Exception": "Use require.", "map": "Use [f(x) for x in ...].",
    "filter": "Use [x for x in ... if ...].", "round": "Use ints.", "divmod": "Use // and %.", "hex": "Use .hex().",
    "self": "There are no classes; use state.", "msg": "Use ctx.", "block": "Use ctx.", "now": "Use ctx.time.",
}  # fmt: skip


class ExpressionChecker:
    """Checks expressions in the current function's scope and collects problems."""

    def __init__(self, diagnostics: list[Diagnostic], source: str, unreadable: frozenset[str] = frozenset()) -> None:
        self.diagnostics = diagnostics
        self.facts = SourceFacts()
        self.unreadable = unreadable
        self._lines = source.split("\n")
        self._place: tuple[int, int] | None = None
        self._bodies: list[FunctionFacts] = []
        self._may_have_entry = False
        self.current: FunctionFacts | None = None
        self.comprehension_names: list[str] = []
        self._depth = 0

    def report(self, node: ast.AST, code: str, message: str, fix: str) -> None:
        """Record a problem; in f-strings at the f-string, since Python versions differ inside."""
        line, offset = self._place or (getattr(node, "lineno", 1), getattr(node, "col_offset", 0))
        before = self._lines[line - 1].encode("utf-8", "replace")[:offset].decode("utf-8", "ignore")
        self.diagnostics.append(Diagnostic(code, line, len(before) + 1, message, fix))

    def operator(self, node: ast.AST, op: ast.operator) -> None:
        if type(op).__name__ in BINARY:
            return
        if isinstance(op, ast.Div):
            self.report(node, "FLOAT", "There are no fractions.", "Use '//'.")
        else:
            self.report(node, "NOT_IN_LANGUAGE", "This operator is not in the language.", "Write it out.")

    def expression(self, node: ast.expr) -> None:
        self._depth += 1
        if self._depth > EXPRESSION_DEPTH_MAX:
            message = f"An expression is nested deeper than {EXPRESSION_DEPTH_MAX} levels."
            self.report(node, "NESTED_TOO_DEEP", message, "Give a part of it a name.")
        else:
            self._dispatch(node)
        self._depth -= 1

    def _dispatch(self, node: ast.expr) -> None:  # noqa: PLR0912 - a case per node type is the subject here
        match node:
            case ast.Constant():
                self._constant(node)
            case ast.Name():
                self._name(node)
            case ast.BinOp():
                self.operator(node, node.op)
                self._all(node.left, node.right)
            case ast.UnaryOp():
                self.expression(node.operand)
            case ast.BoolOp():
                self._all(*node.values)
            case ast.Compare():
                self._compare(node)
            case ast.IfExp():
                self._all(node.test, node.body, node.orelse)
            case ast.Call():
                self._call(node)
            case ast.Attribute():
                self._attribute(node)
            case ast.Subscript():
                self._subscript(node)
            case ast.List() | ast.Tuple():
                self._all(*node.elts)
            case ast.Dict():
                self._dict(node)
            case ast.ListComp() | ast.DictComp():
                self._comprehension(node)
            case ast.JoinedStr():
                self._f_string(node)
            case _:
                message, fix = _REFUSED.get(type(node).__name__, ("This is not in the language.", "Write it out."))
                self.report(node, "NOT_IN_LANGUAGE", message, fix)
                self._inside_refused_expression(node)

    def _inside_refused_expression(self, node: ast.expr) -> None:
        if isinstance(node, ast.Set):
            self._all(*node.elts)
        elif isinstance(node, ast.SetComp | ast.GeneratorExp):
            self._comprehension(node)
        elif isinstance(node, ast.NamedExpr | ast.Starred | ast.Await | ast.Yield | ast.YieldFrom):
            if node.value is not None:
                self.expression(node.value)
        elif isinstance(node, ast.Lambda):
            before = len(self.comprehension_names)
            self.comprehension_names.extend(argument.arg for argument in node.args.args)
            self.expression(node.body)
            del self.comprehension_names[before:]

    def _all(self, *nodes: ast.expr) -> None:
        for node in nodes:
            self.expression(node)

    def _constant(self, node: ast.Constant) -> None:
        value = node.value
        if type(value) is int:
            if value >= INT_LIMIT:
                self.report(node, "NUMBER", "The number is larger than 256 bits.", "Use a smaller one.")
        elif type(value) is float or type(value) is complex:
            self.report(node, "FLOAT", "There are no fractions.", "Use an int, e.g. of thousandths.")
        elif value is not None and type(value) not in (bool, str, bytes):
            self.report(node, "NOT_IN_LANGUAGE", "This is not a value of the language.", "Use None.")

    def is_local(self, name: str) -> bool:
        return name in self.comprehension_names or (self.current is not None and name in self.current.local_names)

    def _name(self, node: ast.Name) -> None:
        name = node.id
        if self.is_local(name) or name in self.facts.constants or name in self.unreadable:
            return
        if name in self.facts.functions or name in RESERVED:
            self.report(
                node, "NOT_A_VALUE", f"{name} is not a value.", f"Call it, or use what belongs to it: {name}..."
            )
        else:
            fix = _BUILTIN_HINTS.get(name, "Define it, or see the reference for the names there are.")
            self.report(node, "NAME_UNKNOWN", f"There is no {name}.", fix)

    def _compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        for position, op in enumerate(node.ops):
            if isinstance(op, ast.Is | ast.IsNot):
                right = operands[position + 1]
                if not (isinstance(right, ast.Constant) and right.value is None):
                    self.report(node, "IDENTITY", "'is' only asks for None.", "Use '=='.")
            elif type(op).__name__ not in COMPARE:
                self.report(node, "NOT_IN_LANGUAGE", "This comparison is not in the language.", "Write it out.")
        self._all(*operands)

    def _attribute(self, node: ast.Attribute) -> None:
        name = dotted_name(node)
        if name is not None and name.startswith("ctx.") and not self.is_local("ctx"):
            if node.attr not in CONTEXT_FIELDS:
                self.report(node, "CONTEXT", f"ctx has no {node.attr}.", f"There are {', '.join(CONTEXT_FIELDS)}.")
            return
        message = f"{node.attr} is not called here, and values have no attributes."
        self.report(node, "ATTRIBUTE", message, f"Call it, .{node.attr}(...), or use value[key].")
        if dotted_name(node.value) not in RESERVED:
            self.expression(node.value)

    def _subscript(self, node: ast.Subscript) -> None:
        self.expression(node.value)
        if isinstance(node.slice, ast.Slice):
            if node.slice.step is not None:
                self.report(node, "SLICE_STEP", "A slice has no step.", "Use reversed, or a comprehension over range.")
            for bound in (node.slice.lower, node.slice.upper, node.slice.step):
                if bound is not None:
                    self.expression(bound)
        else:
            self.expression(node.slice)

    def _dict(self, node: ast.Dict) -> None:
        for key, value in zip(node.keys, node.values, strict=True):
            if key is None:
                self.report(node, "NOT_IN_LANGUAGE", "A dict has no '**'.", "Use .update().")
            else:
                self.expression(key)
            self.expression(value)

    def _comprehension(self, node: ast.ListComp | ast.DictComp | ast.GeneratorExp | ast.SetComp) -> None:
        if len(node.generators) != 1:
            self.report(node, "COMPREHENSION", "A comprehension has one 'for'.", "Use a loop.")
        before = len(self.comprehension_names)
        for generator in node.generators:
            self._generator(node, generator)
        if isinstance(node, ast.DictComp):
            self._all(node.key, node.value)
        else:
            self.expression(node.elt)
        del self.comprehension_names[before:]

    def _generator(self, node: ast.expr, generator: ast.comprehension) -> None:
        self.expression(generator.iter)
        if generator.is_async:
            self.report(node, "NOT_IN_LANGUAGE", "There is no async.", "Remove it.")
        target = generator.target
        elements = target.elts if isinstance(target, ast.Tuple) else [target]
        for element in elements:
            if isinstance(element, ast.Name):
                if element.id in RESERVED:
                    self.report(
                        element, "NAME_RESERVED", f"{element.id} has a meaning of its own.", "Choose another name."
                    )
                self.comprehension_names.append(element.id)
            else:
                self.report(element, "ASSIGNMENT", "A comprehension's 'for' takes names.", "Use a loop.")
        self._all(*generator.ifs)

    def _f_string(self, node: ast.JoinedStr) -> None:
        outer, self._place = self._place, self._place or (node.lineno, node.col_offset)
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                if part.conversion != -1 or part.format_spec is not None:
                    self.report(node, "F_STRING", "An f-string has no '!' and ':'.", "Make the text first.")
                self.expression(part.value)
        self._place = outer

    def _arguments(self, node: ast.Call) -> None:
        for argument in [*node.args, *[keyword.value for keyword in node.keywords]]:
            if isinstance(argument, ast.GeneratorExp) and len(node.args) == 1 and not node.keywords:
                self._comprehension(argument)
            else:
                self.expression(argument)

    def _call(self, node: ast.Call) -> None:
        name = dotted_name(node.func)
        root = "" if name is None else name.split(".")[0]
        if name is None or (isinstance(node.func, ast.Attribute) and self._is_value(root, name)):
            self._method(node)
            return
        if name == "isinstance" and not self.is_local(name):
            self._isinstance(node)
            return
        if root in self.unreadable:
            pass
        elif self.is_local(root) or root in self.facts.constants:
            self.report(node, "NOT_CALLABLE", f"{name} is a variable here and cannot be called.", "Rename one of them.")
        elif name in CALLABLES:
            self._builtin(node, name)
        elif name in self.facts.functions:
            self._function_call(node, name)
        elif root in RESERVED:
            self.report(node, "NAME_UNKNOWN", f"There is no {name}.", "See the reference for the names there are.")
        else:
            self.report(node, "NAME_UNKNOWN", f"There is no {name}.", _BUILTIN_HINTS.get(root, "Define the function."))
        self._arguments(node)

    def _is_value(self, root: str, name: str) -> bool:
        if self.is_local(root) or root in self.facts.constants:
            return True
        return name.startswith("ctx.") or (root not in RESERVED and root not in self.facts.functions and "." in name)

    def _method(self, node: ast.Call) -> None:
        if not isinstance(node.func, ast.Attribute):
            self.report(node, "NOT_CALLABLE", "Only functions and methods can be called.", "Call them by name.")
            self.expression(node.func)
        elif dotted_name(node.func) in {f"ctx.{field}" for field in CONTEXT_FIELDS} and not self.is_local("ctx"):
            self.report(node, "NOT_CALLABLE", "The fields of ctx are values.", "Leave out the brackets.")
        else:
            self.expression(node.func.value)
            if node.func.attr not in METHODS:
                known = ", ".join(sorted(METHODS))
                self.report(
                    node.func, "METHOD_UNKNOWN", f"There is no method {node.func.attr}.", f"There are: {known}."
                )
            else:
                found = bind_method(node.func.attr, node)
                params = next(iter(METHODS[node.func.attr].values())).params
                problem = found if isinstance(found, str) else naming_problem(node.func.attr, params, node)
                if problem:
                    self.report(node, "ARGUMENTS", f"{node.func.attr} {problem}", "See the reference.")
        self._arguments(node)

    def _isinstance(self, node: ast.Call) -> None:
        good = len(node.args) == 2 and not node.keywords
        if not good or not isinstance(node.args[1], ast.Name) or node.args[1].id not in TYPES:
            names = ", ".join(TYPES)
            self.report(node, "ARGUMENTS", "isinstance takes a value and one type.", f"The types are {names}.")
        self._all(*node.args[:1], *node.args[2:], *[keyword.value for keyword in node.keywords])

    def _builtin(self, node: ast.Call, name: str) -> None:
        builtin = CALLABLES[name]
        bound = bind(builtin.params, builtin.required, node, variadic=builtin.variadic)
        if isinstance(bound, str):
            self.report(node, "ARGUMENTS", f"{name} {bound}", f"Its parameters are {', '.join(builtin.params)}.")
        elif None in bound.arguments:
            self.report(node, "ARGUMENTS", f"{name} must get its arguments in order.", "Give those before it too.")
        elif problem := naming_problem(name, builtin.params, node):
            self.report(node, "ARGUMENTS", f"{name} {problem}", "See the reference.")
        elif name == "require":
            code = bound.arguments[1]
            if isinstance(code, ast.Constant) and not (type(code.value) is str and is_author_code(code.value)):
                message = "A code is UPPER_SNAKE text of 3 to 64 characters, and not one of the machine's own."
                self.report(code, "CODE", message, 'Write e.g. require(condition, "NOT_PERMITTED").')
        if name in WRITING and self.current is not None and self.current.writes is None:
            self.current.writes = node

    def _function_call(self, node: ast.Call, name: str) -> None:
        facts = self.facts.functions[name]
        bound = bind(facts.params, facts.required, node)
        if isinstance(bound, str):
            self.report(
                node, "ARGUMENTS", f"{name} {bound}", f"Its parameters are {', '.join(facts.params) or 'none'}."
            )
        if facts.kind == "migrate":
            message = f"{name} is a @migrate, which the machine alone runs."
            self.report(node, "MIGRATE", message, "Move what both need to a helper.")
        if self.current is not None:
            self.current.calls.add(name)

    def constant_expression(self, node: ast.expr) -> None:
        pending: list[ast.AST] = [node]
        while pending:
            part = pending.pop()
            if isinstance(part, ast.BinOp | ast.UnaryOp | ast.Tuple | ast.List | ast.Dict | ast.Constant | ast.Name):
                pending.extend(ast.iter_child_nodes(part))
            elif isinstance(part, ast.expr):
                message = "A constant is made of values, operators and constants above it."
                self.report(part, "CONSTANT", message, "Compute it in a function.")
        self.current = None
        self.expression(node)
