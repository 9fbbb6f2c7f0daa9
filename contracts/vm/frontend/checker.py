"""Checks that a source is in the contract language; node types not named are refused."""

from __future__ import annotations

import ast
import re

from contracts.vm.frontend.abi import TYPE_HELP, parse_type, type_text
from contracts.vm.frontend.checker_expressions import ExpressionChecker
from contracts.vm.frontend.lexer_guard import WORDS, prelex
from contracts.vm.frontend.name_binding import (
    KIND_HELP,
    KINDS,
    RESERVED,
    FunctionFacts,
    SourceFacts,
    bound_names,
    dotted_name,
)
from contracts.vm.frontend.parser import parse_source, read_what_can_be_read
from contracts.vm.model.faults import ContractSourceError, Diagnostic

_SAID_BY = {"FLOAT": "NUMBER", "NO_EFFECT": "NOT_IN_LANGUAGE"}
_CONTRACT_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}", re.ASCII)

_REFUSED: dict[str, tuple[str, str]] = {
    "Import": WORDS["import"],
    "ImportFrom": WORDS["import"],
    "ClassDef": WORDS["class"],
    "AsyncFunctionDef": WORDS["async"],
    "AsyncFor": WORDS["async"],
    "AsyncWith": WORDS["async"],
    "Try": WORDS["try"],
    "TryStar": WORDS["try"],
    "Raise": WORDS["raise"],
    "Assert": WORDS["assert"],
    "With": WORDS["with"],
    "Global": WORDS["global"],
    "Nonlocal": WORDS["nonlocal"],
    "Match": ("There is no match.", "Use if and elif."),
    "TypeAlias": WORDS["type"],
    "FunctionDef": ("There are no nested functions.", "Move it to the top."),
}


def check_source(source: str, name: str) -> SourceFacts:
    """Stops if unparsable. Raises ContractSourceError."""
    check_name(name)
    text = prelex(source)
    verdict = min(text.diagnostics, key=lambda one: (one.line, one.column), default=None)
    if text.fatal:
        raise ContractSourceError(name, _sorted(text.diagnostics), verdict)
    tree = parse_source(source)
    if isinstance(tree, Diagnostic):
        unreadable = Diagnostic("SYNTAX", 1, 1, "This is not Python.", "Check the source where it is written.")
        raise ContractSourceError(name, _sorted([*text.diagnostics, tree]), verdict or unreadable)
    checker = Checker(text.diagnostics, source)
    checker.module(tree)
    if checker.diagnostics:
        raise ContractSourceError(name, _sorted(checker.diagnostics), verdict)
    return checker.facts


def check_thoroughly(source: str, name: str) -> tuple[tuple[Diagnostic, ...], SourceFacts]:
    """Return all problems in source order and the facts; may parse repeatedly."""
    try:
        check_name(name)
        diagnostics: list[Diagnostic] = []
    except ContractSourceError as error:
        diagnostics = list(error.diagnostics)
    text = prelex(source)
    diagnostics += text.diagnostics
    tree, unreadable = read_what_can_be_read(source, text, diagnostics)
    checker = Checker(diagnostics, source, unreadable)
    if tree is not None:
        checker.module(tree)
    return _sorted(checker.diagnostics), checker.facts


def check_name(name: str) -> None:
    """Raises ContractSourceError for an invalid contract name."""
    if _CONTRACT_NAME.fullmatch(name) is None:
        message = "A contract's name is 1 to 32 of a-z, 0-9, '-' and '_', a letter first."
        raise ContractSourceError("contract", (Diagnostic("CONTRACT_NAME", 1, 1, message, "Choose such a name."),))


def _sorted(diagnostics: list[Diagnostic]) -> tuple[Diagnostic, ...]:
    unique = {(one.line, one.column, one.code): one for one in reversed(diagnostics)}
    for line, column, code in list(unique):
        if (line, column, _SAID_BY.get(code, "")) in unique:
            del unique[line, column, code]
    return tuple(unique[place] for place in sorted(unique))


class Checker(ExpressionChecker):
    """Checks modules, functions and statements."""

    def module(self, tree: ast.Module) -> None:
        for position, statement in enumerate(tree.body):
            if isinstance(statement, ast.FunctionDef):
                self._declare_function(statement)
            elif isinstance(statement, ast.Assign | ast.AnnAssign):
                self._declare_constant(statement)
            elif not (position == 0 and _is_docstring(statement)):
                self._at_the_top(statement)
        for facts in self._bodies:
            self._function(facts)
        self._check_views()
        self._check_migration()
        if not self._may_have_entry and not self.unreadable:
            self.report(
                tree, "NO_ENTRY", "The contract has no entry.", "Mark a function with @export, @view or @genesis."
            )

    def _at_the_top(self, node: ast.stmt) -> None:
        if not isinstance(node, ast.Import | ast.ImportFrom | ast.ClassDef):
            empty = ast.FunctionDef("_", ast.arguments([], [], None, [], [], None, []), [node], [])
            self._bodies.append(FunctionFacts(empty, "", (), bound_names([node])))
        self.unreadable |= bound_names([node])
        self._refuse_statement(node, "At the top there are only constants and functions.")

    def _refuse_statement(self, node: ast.stmt, otherwise: str) -> None:
        message, fix = _REFUSED.get(type(node).__name__, (otherwise, "Move it into a function."))
        self.report(node, "NOT_IN_LANGUAGE", message, fix)

    def _inside_refused(self, node: ast.stmt, *, in_loop: bool) -> None:
        if isinstance(node, ast.Try | ast.TryStar):
            bodies = [node.body, *[handler.body for handler in node.handlers], node.orelse, node.finalbody]
            for body in bodies:
                self._block(body, in_loop=in_loop)
        elif isinstance(node, ast.With | ast.AsyncWith):
            self._all(*[item.context_expr for item in node.items])
            self._block(node.body, in_loop=in_loop)
        elif isinstance(node, ast.Assert):
            self.expression(node.test)
        elif isinstance(node, ast.AsyncFor):
            self.expression(node.iter)
            self._block([*node.body, *node.orelse], in_loop=True)
        elif isinstance(node, ast.Match):
            self.expression(node.subject)
            for case in node.cases:
                self._block(case.body, in_loop=in_loop)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            outer, arguments = self.current, node.args
            names = {one.arg for one in [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]}
            local = frozenset(names) | bound_names(node.body) | (outer.local_names if outer else frozenset())
            shell = ast.FunctionDef(node.name, arguments, node.body, [])
            self.current = FunctionFacts(shell, "", (), local)
            self._block(node.body, in_loop=False)
            self.current = outer

    def _declare_name(self, node: ast.AST, name: str) -> bool:
        if name in RESERVED:
            self.report(node, "NAME_RESERVED", f"{name} has a meaning of its own.", "Choose another name.")
        elif name in self.facts.constants or name in self.facts.functions:
            self.report(node, "NAME_TWICE", f"{name} is already defined.", "Choose another name.")
        elif name.startswith("__") or name == "_":
            self.report(node, "NAME_RESERVED", f"{name} is not a name for this.", "Choose another name.")
        else:
            return True
        return False

    def _declare_constant(self, node: ast.Assign | ast.AnnAssign) -> None:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        before = len(self.diagnostics)
        if isinstance(node, ast.AnnAssign) and parse_type(node.annotation) is None:
            self.report(node.annotation, "ANNOTATION", "This is not a type of the language.", TYPE_HELP)
        if node.value is not None:
            self.constant_expression(node.value)
        if len(targets) != 1 or not isinstance(targets[0], ast.Name) or node.value is None:
            self.report(node, "CONSTANT", "A constant is 'NAME = value'.", "Write one name and one value.")
            self.unreadable |= bound_names([node])
        elif self._declare_name(node, targets[0].id):
            self.facts.constants[targets[0].id] = node.value
            if len(self.diagnostics) > before:
                self.facts.doubtful.add(targets[0].id)

    def _declare_function(self, node: ast.FunctionDef) -> None:
        kind = self._kind(node)
        params = self._params(node, kind)
        facts = FunctionFacts(node, kind, params, bound_names(node.body) | frozenset(params))
        self._bodies.append(facts)
        if self._declare_name(node, node.name):
            self.facts.functions[node.name] = facts

    def _kind(self, node: ast.FunctionDef) -> str:
        kind = ""
        for decorator in node.decorator_list:
            if not isinstance(decorator, ast.Name) or decorator.id not in KINDS:
                self.report(decorator, "DECORATOR", "This decorator is unknown.", KIND_HELP)
                self._may_have_entry = True
            elif kind:
                self.report(decorator, "DECORATOR", "A function has at most one decorator.", "Remove one.")
            else:
                kind = decorator.id
        self._may_have_entry = self._may_have_entry or kind not in ("", "migrate")
        if kind and node.name.startswith("_"):
            self.report(node, "NAME_RESERVED", "An entry's name does not start with '_'.", "Choose another name.")
        return kind

    def _params(self, node: ast.FunctionDef, kind: str) -> tuple[str, ...]:
        arguments = node.args
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs or arguments.posonlyargs:
            self.report(node, "PARAMETERS", "There are only plain parameters.", "Remove '*', '/' and '**'.")
        if getattr(node, "type_params", None):
            self.report(node, "PARAMETERS", "There are no type parameters.", "Remove them.")
        seen: set[str] = set()
        for argument in arguments.args:
            if argument.arg in seen:
                self.report(argument, "NAME_TWICE", f"There is a parameter {argument.arg} already.", "Rename one.")
            seen.add(argument.arg)
            if argument.arg in RESERVED:
                self.report(
                    argument, "NAME_RESERVED", f"{argument.arg} has a meaning of its own.", "Choose another name."
                )
            if argument.annotation is None and kind:
                message = f"The parameter {argument.arg} of an entry has no type."
                self.report(argument, "ANNOTATION_MISSING", message, f"Write {argument.arg}: TYPE. {TYPE_HELP}")
            elif argument.annotation is not None and parse_type(argument.annotation) is None:
                self.report(argument, "ANNOTATION", "This is not a type of the language.", TYPE_HELP)
        if node.returns is not None and parse_type(node.returns) is None:
            self.report(node.returns, "ANNOTATION", "This is not a type of the language.", TYPE_HELP)
        for default in arguments.defaults:
            self.constant_expression(default)
        return tuple(argument.arg for argument in arguments.args)

    def _function(self, facts: FunctionFacts) -> None:
        self.current = facts
        self.comprehension_names = []
        body = facts.node.body
        self._block(body[1:] if _is_docstring(body[0]) and len(body) > 1 else body, in_loop=False)

    def _block(self, body: list[ast.stmt], *, in_loop: bool) -> None:
        for statement in body:
            self._statement(statement, in_loop=in_loop)

    def _statement(self, node: ast.stmt, *, in_loop: bool) -> None:  # noqa: PLR0912 - a case per node type
        match node:
            case ast.Assign():
                self._assign(node)
            case ast.AugAssign():
                self.operator(node, node.op)
                self._target(node.target, "AUGMENTED")
                self.expression(node.value)
            case ast.AnnAssign():
                self._annotated(node)
            case ast.Expr():
                self._expression_statement(node)
            case ast.Return():
                if node.value is not None:
                    self.expression(node.value)
            case ast.If() | ast.While() | ast.For():
                self._compound(node, in_loop=in_loop)
            case ast.Break() | ast.Continue():
                if not in_loop:
                    self.report(node, "OUTSIDE_LOOP", "There is no loop here.", "Remove it.")
            case ast.Delete():
                for target in node.targets:
                    if not isinstance(target, ast.Subscript) or isinstance(target.slice, ast.Slice):
                        self.report(node, "DELETE", "Only an item can be deleted.", "Write del container[key].")
                    self.expression(target)
            case ast.Pass():
                pass
            case _:
                self._refuse_statement(node, "This statement is not in the language.")
                self._inside_refused(node, in_loop=in_loop)

    def _assign(self, node: ast.Assign) -> None:
        if len(node.targets) != 1:
            self.report(node, "ASSIGNMENT", "One assignment has one target.", "Write two assignments.")
        for target in node.targets:
            self._target(target, "PLAIN")
        self.expression(node.value)

    def _annotated(self, node: ast.AnnAssign) -> None:
        if not isinstance(node.target, ast.Name) or node.value is None:
            self.report(node, "ASSIGNMENT", "A typed assignment is 'name: type = value'.", "Give it a value.")
        if parse_type(node.annotation) is None:
            self.report(node.annotation, "ANNOTATION", "This is not a type of the language.", TYPE_HELP)
        self._target(node.target, "PLAIN")
        if node.value is not None:
            self.expression(node.value)

    def _expression_statement(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Call) and not (
            isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        ):
            self.report(node, "NO_EFFECT", "This has no effect.", "Assign it, return it or remove it.")
        self.expression(node.value)

    def _compound(self, node: ast.If | ast.While | ast.For, *, in_loop: bool) -> None:
        if isinstance(node, ast.For):
            self._target(node.target, "LOOP")
            self.expression(node.iter)
        else:
            self.expression(node.test)
        looping = in_loop or not isinstance(node, ast.If)
        self._block(node.body, in_loop=looping)
        if node.orelse and not isinstance(node, ast.If):
            self.report(node, "LOOP_ELSE", "A loop has no else.", "Use a variable.")
        self._block(node.orelse, in_loop=in_loop)

    def _target(self, node: ast.expr, use: str) -> None:
        if isinstance(node, ast.Name):
            if node.id in RESERVED:
                self.report(node, "NAME_RESERVED", f"{node.id} has a meaning of its own.", "Choose another name.")
        elif isinstance(node, ast.Subscript) and use != "LOOP" and not isinstance(node.slice, ast.Slice):
            self.expression(node.value)
            self.expression(node.slice)
        elif isinstance(node, ast.Tuple | ast.List) and use != "AUGMENTED" and node.elts:
            for element in node.elts:
                if isinstance(element, ast.Name):
                    self._target(element, use)
                else:
                    self.report(element, "ASSIGNMENT", "Only names can be unpacked into.", "Assign in two steps.")
                    self._inside_target(element)
        else:
            self.report(node, "ASSIGNMENT", "This cannot be assigned to.", "Assign to a name or an item.")
            self._inside_target(node)

    def _inside_target(self, node: ast.expr) -> None:
        if isinstance(node, ast.Subscript) and not isinstance(node.slice, ast.Slice):
            self._all(node.value, node.slice)
        elif isinstance(node, ast.Attribute | ast.Subscript) and dotted_name(node.value) not in RESERVED:
            self.expression(node.value)

    def _check_views(self) -> None:
        functions = self.facts.functions
        for facts in functions.values():
            if facts.kind != "view":
                continue
            pending, seen = [facts.node.name], set()
            while pending:
                name = pending.pop()
                if name in seen:
                    continue
                seen.add(name)
                if functions[name].writes is not None:
                    message = f"The view {facts.node.name} changes the state or emits, by way of {name}."
                    self.report(facts.node, "VIEW_WRITES", message, "Make it an @export, or leave that out.")
                    break
                pending.extend(sorted(functions[name].calls & functions.keys(), reverse=True))

    def _check_migration(self) -> None:
        """Only the machine runs migrations: they take and return nothing."""
        migrations = [facts for facts in self.facts.functions.values() if facts.kind == "migrate"]
        for facts in migrations[1:]:
            message = f"A source has one @migrate, and {migrations[0].node.name} is that."
            self.report(facts.node, "MIGRATE", message, "Let one do all of it, or make this a helper.")
        for facts in migrations:
            if facts.params:
                self.report(facts.node, "MIGRATE", "A @migrate takes no parameters.", "Read what it needs.")
            if facts.node.returns is not None and type_text(facts.node.returns) != "None":
                self.report(facts.node.returns, "MIGRATE", "A @migrate has no result.", "Remove the type.")
            for part in ast.walk(facts.node):
                if isinstance(part, ast.Return) and part.value is not None:
                    self.report(part, "MIGRATE", "A @migrate has no result.", "Write 'return' alone.")


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
