"""Generates random programs: from a grammar, and by mutation."""

from __future__ import annotations

import random
import re
from collections.abc import Sequence

from contracts.vm.builtins.methods import METHODS
from contracts.vm.frontend.name_binding import CALLABLES

_NAMES = ("a", "b", "c", "x", "y", "z", "i")
_LEAVES = (
    "0", "1", "-1", "2", "7", "255", "256", "2 ** 60", "2 ** 61 - 1", "2 ** 255", "10 ** 70", "True", "False", "None",
    "''", "'a'", "'abc'", "'a b,c'", "'\\xe9'", "'\\u20ac' * 9", "'12'", "'ff00'", "'UPPER_CODE'", "b''", "b'a'",
    "b'ab' * 20", "b'\\xff'", "bytes(65)", "[]", "[1, 2]", "['a', 'b']", "[b'x']", "[[1], [2]]", "{}", "{'a': 1}",
    "{1: [2]}", "{b'k': {}}", "()", "(1, 2)", "range(5)", "range(2 ** 59)", "ctx.caller", "ctx.height", "ctx.time",
    "ctx.txid", "ctx.contract", "'big'",
)  # fmt: skip
_CONSTANTS_COUNT = 26
SIGNS = (
    "+", "-", "*", "//", "%", "**", "<<", ">>", "&", "|", "^",
    "==", "!=", "<", "<=", ">", ">=", "in", "not in", "and", "or",
)  # fmt: skip
FUNCTIONS: dict[str, tuple[int, int]] = {
    name: (builtin.required, builtin.required + 2 if builtin.variadic else len(builtin.params))
    for name, builtin in sorted(CALLABLES.items())
    if name not in ("call", "charge_source", "check_source", "require")
}
_METHODS: dict[str, tuple[int, int]] = {
    name: (min(method.required for method in table.values()), max(len(method.params) for method in table.values()))
    for name, table in sorted(METHODS.items())
}
_CALLS = (
    "g({0}, {1})", "h({0})", "call('other', 'f', {0})", "call('other', 'v')", "call('it', 'f', {0}, {1})",
    "call({0}, {1})",
)  # fmt: skip
_SHAPES = (
    "[{0}, {1}]", "({0}, {1})", "{{{0}: {1}}}", "{0}[{1}]", "{0}[{1}:{2}]", "({0} if {1} else {2})", "(not {0})",
    "(-{0})", "(~{0})", "[{0} for i in {1} if {2}]", "{{{0}: {1} for i in {2}}}", "sum({0} for i in {1})",
    "({0} is None)", "({0} < {1} < {2})", "f'{{x}}{{i}}'", "isinstance({0}, int)",
)  # fmt: skip
_TYPED: dict[str, tuple[str, ...]] = {
    "int": (
        "c", "c", "3", "17", "-2", "({int} + {int})", "({int} * {int})", "({int} - {int})", "({int} % 7)", "({int} // 3)",
        "len({list})", "len({str})", "int.from_bytes({bytes}[:8])", "{str}.find({str})", "sum({list})", "abs({int})",
        "max({int}, {int})", "({int} if {bool} else {int})", "({int} & 255)", "({int} >> 3)", "{list}.copy().pop()",
        "state.get({key}, 0)", "({int}).bit_length()", "{str}.count({str})", "g({int}, {int})", "z.get('n', {int})",
    ),
    "str": (
        "y", "y", "'abc'", "''", "({str} + {str})", "str({int})", "{str}.upper()", "{str}.strip()", "{str}[{int} % 3 :]",
        "{str}.replace({str}, {str})", "f'{{y}}-{{c}}'", "{bytes}.hex()", "','.join([{str}, {str}])", "({str} * 3)",
    ),
    "bytes": (
        "b'k'", "u64(abs({int}) % 999)", "({bytes} + {bytes})", "sha256({bytes})", "{str}.encode()", "{bytes}[1:3]",
        "ctx.caller", "tagged_hash('t', {bytes})", "({int} % 99).to_bytes(4)", "b','.join([{bytes}])",
    ),
    "key": ("b'k'", "b'a'", "u32(abs({int}) % 5)", "(b'k' + u32(abs(c) % 9))"),
    "list": (
        "x", "x", "[{int}, {int}]", "({list} + {list})", "sorted({list})", "[i for i in {list} if {bool}]", "{list}[1:]",
        "[{int} for i in {list}]", "list(range({int} % 20))", "reversed({list})", "[p[0] for p in enumerate({list})]",
    ),
    "dict": ("z", "{{'n': {int}, 's': {str}}}", "{{i: {int} for i in {list}}}", "{dict}.copy()", "{{1: {list}}}"),
    "bool": (
        "({int} < {int})", "({int} in {list})", "(not {bool})", "({str} == {str})", "({bool} and {bool})",
        "state.has({key})", "({list} == {list})", "{str}.startswith({str})", "all({list})",
        "({bytes} != {bytes})", "('n' in {dict})",
    ),
}  # fmt: skip
_TYPED_STATEMENTS = (
    "c = {int}", "c = {int}", "x = {list}", "y = {str}", "z = {dict}", "c += {int}", "x.append({int})", "x.sort()",
    "x.extend({list})", "z['n'] = {int}", "z.update({dict})", "state.put({key}, {int})", "state.put({key}, {dict})",
    "state.delete({key})", "emit('done', {dict})", "call('other', 'f', {list})", "require({bool} or c, 'NOT_SO')",
    "i = {int}", "return {list}", "return [c, x, y, z]", "x = [p[1] for p in state.scan(b'', 5)]\n    x = []", "h({int})",
)  # fmt: skip
_TYPED_LEFT = {"int": "c", "str": "y", "bytes": "b'ab'", "list": "x", "dict": "z", "bool": "(c < 9)", "key": "b'k'"}
_HOLE = re.compile(r"\{(int|str|bytes|key|list|dict|bool)\}")
_SPLIT = re.compile(r"(\w+|\s+|.)")
_PIECES = (
    "(", ")", "[", "]", "{", "}", ":", ",", ".", "=", "*", "**", "@", "'", '"', "\\", "#", "\n", "    ", "\t", "lambda",
    "yield", "def", "for", "if", "else", "in", "not", "is", "None", "return", "try", "__class__", "f'{x}'", "{x!r}", "0x",
    "1e9", "\u0441", "\ud7ff", "\x00", "\r", ";", ":=", "->", "...", "async", "await", "import os", "global x", "del",
    "pass", "while", "class A", "__import__", "_", "export", "view", "migrate", "genesis", "state", "ctx", "len",
    "require", "emit", "call", "2 ** 256",
)  # fmt: skip
_OTHER = (
    "@export\ndef f(x: object = 0) -> object:\n    state.put(b'k', x)\n    return x\n\n\n"
    "@view\ndef v() -> object:\n    return state.get(b'k')\n"
)
_OPENING = "    c = 5\n    x = [3, 1, 2]\n    y = 'text'\n    z = {'n': 1, 'a': b}\n    i = a"
OTHERS = {"other": _OTHER}


class Grammar:
    """Draws contract sources with entry `f(a, b)`, bounded by gas alone."""

    def __init__(self, chance: random.Random) -> None:
        self._chance = chance
        self._tame = chance.choice((0.0, 0.8, 0.97, 1.0, 1.0))

    def source(self) -> str:
        chance = self._chance
        constants = "".join(f"K{n} = {self._constant()}\n" for n in range(chance.randrange(3)))
        default = chance.choice(_LEAVES[:_CONSTANTS_COUNT])
        first = f"def g(a, b={default}):\n{_OPENING}\n{self._block(1, 2)}\n    return c\n"
        helper = f"{first}\n\ndef h(a):\n    b = a\n{_OPENING}\n{self._block(1, 2)}\n"
        kind = "view" if chance.random() < 0.1 else "export"
        return f"{constants}\n{helper}\n\n@{kind}\ndef f(a: object, b: object):\n{_OPENING}\n{self._block(1, 3)}\n"

    def _constant(self) -> str:
        chance = self._chance
        leaves = [chance.choice(_LEAVES[:_CONSTANTS_COUNT]) for _ in range(2)]
        return chance.choice(("{0}", "[{0}, {1}]", "({0}, {1})", "{0} + {1}", "{0} * 3", "{{'k': {0}}}")).format(
            *leaves
        )

    def _fill(self, shape: str, left: int) -> str:
        def fill(hole: re.Match[str]) -> str:
            kind = hole[1]
            return self._fill(self._chance.choice(_TYPED[kind]), left - 1) if left else _TYPED_LEFT[kind]

        return _HOLE.sub(fill, shape).replace("{{", "{").replace("}}", "}")

    def _block(self, depth: int, left: int) -> str:
        lines = [self._statement(depth, left) for _ in range(self._chance.randint(1, 4))]
        return "\n".join(lines)

    def _statement(self, depth: int, left: int) -> str:  # noqa: PLR0911 - one per kind
        chance, space = self._chance, "    " * depth
        if chance.random() < self._tame:
            if not left or chance.random() < 0.7:
                return space + self._fill(chance.choice(_TYPED_STATEMENTS), 3).replace("\n    ", "\n" + space)
            head = self._fill(
                chance.choice(("if {bool}:", "for i in {list}:", "for i in range(9):", "while {bool}:")), 2
            )
            leave = f"\n{space}    break" if head.startswith("while") and chance.random() < 0.8 else ""
            return f"{space}{head}\n{self._block(depth + 1, left - 1)}{leave}"
        kind = chance.randrange(14 if left else 9)
        if kind < 3:
            return f"{space}{chance.choice(_NAMES)} = {self.expression()}"
        if kind == 3:
            sign = chance.choice(("+", "-", "*", "//", "|"))
            return f"{space}{chance.choice(('x', 'x[y]', 'a', 'i'))} {sign}= {self.expression(1)}"
        if kind == 4:
            return f"{space}x[{self.expression(1)}] = {self.expression(1)}"
        if kind == 5:
            return f"{space}return {self.expression()}"
        if kind == 6:
            return f"{space}{self._call(2)}"
        if kind == 7:
            return f"{space}x, y = {self.expression(1)}"
        if kind == 8:
            last = ("pass", "del x[0]", "require(a, 'NO_WAY')", "x = []", "emit('e', {'a': a})")
            return f"{space}{chance.choice(last)}"
        heads = ("if {0}:", "while {0}:", "for i in {0}:", "for x, y in {0}:", "for x in range(9):")
        head = chance.choice(heads).format(self.expression(2))
        tail = (
            f"\n{space}else:\n{self._block(depth + 1, left - 1)}"
            if head.startswith("if") and chance.random() < 0.4
            else ""
        )
        leave = f"\n{space}    {chance.choice(('break', 'continue'))}" if not head.startswith("if") else ""
        return f"{space}{head}\n{self._block(depth + 1, left - 1)}{leave if chance.random() < 0.3 else ''}{tail}"

    def expression(self, left: int = 3) -> str:
        chance = self._chance
        kind = chance.randrange(12) if left else chance.randrange(3)
        if kind < 2:
            return chance.choice(_NAMES)
        if kind == 2:
            return chance.choice(_LEAVES)
        one, other, third = (self.expression(left - 1) for _ in range(3))
        if kind < 6:
            return f"({one} {chance.choice(SIGNS)} {other})"
        if kind < 10:
            return self._call(left - 1)
        return chance.choice(_SHAPES).format(one, other, third)

    def _call(self, left: int) -> str:
        chance = self._chance
        arguments = [self.expression(max(left - 1, 0)) for _ in range(4)]
        kind = chance.randrange(8)
        if kind == 7:
            return chance.choice(_CALLS).format(*arguments)
        name, (least, most) = chance.choice(list((FUNCTIONS if kind < 4 else _METHODS).items()))
        given = ", ".join(arguments[1 : 1 + chance.randint(least, most)])
        return f"{name}({given})" if kind < 4 else f"({arguments[0]}).{name}({given})"


def mutate(source: str, chance: random.Random, others: Sequence[str]) -> str:
    pieces = _SPLIT.findall(source)[:4000] or ["x"]
    for _ in range(chance.choice((1, 1, 2, 3, 6))):
        place = chance.randrange(len(pieces))
        kind = chance.randrange(6)
        if kind == 0:
            del pieces[place : place + chance.choice((1, 1, 2, 8))]
        elif kind == 1:
            pieces[place] = chance.choice(_PIECES)
        elif kind == 2:
            pieces.insert(place, chance.choice(_PIECES))
        elif kind == 3:
            end = place + chance.choice((1, 4, 20))
            pieces[place:place] = pieces[place:end] * chance.choice((1, 1, 2, 30))
        elif kind == 4:
            other = chance.randrange(len(pieces))
            pieces[place], pieces[other] = pieces[other], pieces[place]
        else:
            found = _SPLIT.findall(chance.choice(others))
            start = chance.randrange(max(len(found), 1))
            pieces[place:place] = found[start : start + chance.choice((1, 3, 10))]
        pieces = pieces or ["x"]
    return "".join(pieces)
