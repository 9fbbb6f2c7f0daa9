"""Programs of the contract language, made at random by type, so that most of them run and all of them are read."""

from __future__ import annotations

import re
from random import Random

from tests.property.contract_phrases import BLOCKS, HEAD, PHRASES, SIGNS, STATEMENTS

TYPES = ("int", "str", "bytes", "bool", "ints", "strs", "table", "pair", "grid", "byint")
ANNOTATIONS = {
    "ints": "list[int]", "strs": "list[str]", "table": "dict[str, int]", "pair": "object", "grid": "list[list[int]]",
    "byint": "dict[int, str]",
}  # fmt: skip
LEAVES = {
    "ints": "[3, 1, 2]", "strs": "['b', 'a', '']", "table": "{'a': 1, 'b': 2}", "pair": "(1, 'a')", "grid": "[[1], [2, 3]]",
    "byint": "{1: 'a', -1: 'b'}",
}  # fmt: skip
KINDS = ("int", "str", "list", "dict", "bool", "bytes", "tuple")
HOLE = re.compile(r"\{\{|\}\}|\{(\w+)(!?)\}")
INTS = ("0", "1", "2", "7", "255", "(-1)", "0x1f", "(2 ** 64)", "(2 ** 63 - 1)", "(2 ** 255)", "-(2 ** 255)")
STRS = ("''", "'a'", "'abc'", "'a,b'", "' x '", "'12'", "'-7'", "'Zz9'", "'é'", "'ab' 'ab'", "'\\n\\x41\\u00e9'")
BYTES = ("b''", "b'a'", "b'ab'", "b'\\x00\\xff'", "b'abab'")
TEXT_METHODS = (".upper()", ".lower()", ".strip()", ".lstrip('a')", ".rstrip()", ".replace('a', 'bb')")
TEXT_TESTS = (".isdigit()", ".isalpha()", ".isalnum()", ".isupper()", ".islower()", ".isascii()")
MISTAKES = (
    "(1 + 'a')", "len(5)", "('a' < 1)", "None[0]", "[] - [1]", "'a' * 'b'", "-'a'", "sum(['a'])", "{}[[]]", "(1)[0]",
    "5 in 5", "[1] + (2,)", "sorted([1, 'a'])", "'a'.append(1)", "b'a' + 'a'", "abs('a')", "[1]['a']", "~None",
    "'a' in 5", "[1, 2]['a':]", "max(1, 'a')", "'a'.join([1])", "(5).upper()", "range('a')", "bytes('a')",
)  # fmt: skip


class ProgramWriter:
    """Writes one program: an entry `f`, some helpers, state and events."""

    def __init__(self, random: Random) -> None:
        self.random = random
        self.variables: dict[str, str] = {}
        self.maybe: list[str] = []
        self.helpers: list[tuple[str, list[str], str]] = []
        self.count = 0
        self.result = "int"

    def pick(self, options: tuple[str, ...] | list[str]) -> str:
        return options[self.random.randrange(len(options))]

    def chance(self, one_in: int) -> bool:
        return self.random.randrange(one_in) == 0

    def or_risky(self, safe: str, risky: str) -> str:
        """Mostly what cannot fail, so that programs come to their end."""
        return risky if self.chance(15) else safe

    def fresh(self, prefix: str = "v") -> str:
        self.count += 1
        return f"{prefix}{self.count}"

    def named(self, kind: str) -> list[str]:
        return [name for name, other in self.variables.items() if other == kind]

    def expression(self, kind: str, depth: int) -> str:
        names = self.named(kind)
        if depth <= 0 or self.chance(5):
            return self.pick(names) if names and not self.chance(3) else self.leaf(kind)
        if self.chance(300):
            return f"({self.pick(MISTAKES)})"
        if self.maybe and kind == "int" and self.chance(40):
            return self.pick(self.maybe)
        fitting = [helper for helper in self.helpers if helper[2] == kind]
        if fitting and self.chance(3):
            return self.call(fitting[self.random.randrange(len(fitting))], depth)
        if self.chance(8):
            test, one, other = self.expression("bool", depth - 1), self.expression(kind, depth - 1), self.leaf(kind)
            return f"({one} if {test} else {other})"
        if kind in ("pair", "grid", "byint") or self.chance(2):
            return self.filled(self.pick(PHRASES[kind]), depth - 1)
        return str(getattr(self, f"of_{kind}")(depth - 1))

    def filled(self, phrase: str, depth: int) -> str:
        """Return a phrase with expressions and variables in its holes."""
        one = self.pick(TYPES)

        def fill(hole: re.Match[str]) -> str:
            if hole[0] in ("{{", "}}"):
                return hole[0][0]
            kind = one if hole[1] == "any" else hole[1]
            if kind in ("key", "sign"):
                return self.pick(SIGNS) if kind == "sign" else f"({self.pick(BYTES)} + b'k')"
            names = self.named(kind)
            if hole[2]:
                return self.pick(names) if names else self.leaf(kind)
            return self.expression(kind, depth)

        return HOLE.sub(fill, phrase)

    def leaf(self, kind: str) -> str:
        if kind == "int" and self.helpers and self.chance(15):
            return f"note({self.random.randrange(99)})"
        if kind in LEAVES:
            return LEAVES[kind]
        leaves = {"int": INTS, "str": STRS, "bytes": BYTES, "bool": ("True", "False")}
        return self.pick(leaves[kind])

    def call(self, helper: tuple[str, list[str], str], depth: int) -> str:
        name, kinds, _ = helper
        values = [self.expression(kind, depth - 1) for kind in kinds]
        if self.chance(2):
            named = [f"p{place}={value}" for place, value in enumerate(values)]
            first = self.random.randrange(len(values) + 1)
            return f"{name}({', '.join([*values[:first], *named[first:]])})"
        return f"{name}({', '.join(values)})"

    def of_int(self, depth: int) -> str:
        def some(kind: str = "int") -> str:
            return self.expression(kind, depth)

        choice = self.random.randrange(20)
        if choice < 7:
            sign = self.pick(["+", "-", "*", "//", "%", "&", "|", "^", "+", "-"])
            large = sign in "+-*" and not self.chance(15)
            left = f"({some()} % {2**100})" if large else some()
            right = f"({some()} % {2**100})" if large else self.or_risky(f"({some()} | 1)", some())
            return f"({left} {sign} {right})"
        if choice == 7:
            power = self.or_risky("9", "300")
            return f"(({some()} % {2**20}) {self.pick(['**', '<<', '>>'])} ({some()} % {power}))"
        return (
            lambda: f"({self.pick(['-', '~', '+'])}({some()} >> 1))",
            lambda: f"len({some(self.pick(['str', 'bytes', 'ints', 'strs', 'table']))})",
            lambda: self.or_risky(f"({some('ints')} + [8, 9])[{self.pick(['0', '-1', '1'])}]", f"{some('ints')}[3]"),
            lambda: self.or_risky(f"{{'a': {some()}}}['a']", f"{some('table')}[{self.pick(STRS)}]"),
            lambda: f"{some('table')}.get({some('str')}, {some()})",
            lambda: f"{self.pick(['sum', 'min', 'max'])}({some('ints')}[:2] + [1])",
            lambda: f"{self.pick(['min', 'max'])}({some()}, {some()})",
            lambda: f"int({self.or_risky('str(' + some() + ' % 999)', some('str'))})",
            lambda: f"abs({some()})",
            lambda: f"int.from_bytes({some('bytes')}[:8], {self.pick([chr(39) + 'big' + chr(39), repr('little')])})",
            lambda: f"{some('str')}.{self.pick(['find', 'count'])}({some('str')})",
            lambda: self.or_risky(f"({some('bytes')} + b'z')[0]", f"{some('ints')}.index({some()})"),
        )[choice - 8]()

    def of_str(self, depth: int) -> str:
        def some(kind: str = "str") -> str:
            return self.expression(kind, depth)

        return (
            lambda: f"({some()} + {some()})",
            lambda: f"({some()} * ({some('int')} % 4))",
            lambda: f"{some()}[{self.bound(depth)}:{self.bound(depth)}]",
            lambda: f"({some()} + 'yz'){self.or_risky('[1]', '[5]')}",
            lambda: f"str({some(self.pick(['int', 'bool', 'str']))})",
            self.f_string,
            lambda: f"({some()}){self.pick(TEXT_METHODS)}",
            lambda: f"{some()}.join({some('strs')})",
            lambda: f"{some('bytes')}.{self.or_risky('hex', 'decode')}()",
            lambda: f"({some('strs')} + ['q']){self.or_risky('[0]', '[3]')}",
        )[self.random.randrange(10)]()

    def f_string(self) -> str:
        names = [*self.named("int"), *self.named("str"), *self.named("bool")]
        parts = [f"{{{self.pick(names)}}}" if names else "{1 + 1}", "{{x}}", self.pick(["a", "{None}", "{True}"])]
        return "f'" + " ".join(parts) + "'" + self.pick(["", " 'tail'", " f'{2}'"])

    def bound(self, depth: int) -> str:
        return self.pick(["", "1", "-1", "2", "100", f"{self.expression('int', depth)}"])

    def of_bytes(self, depth: int) -> str:
        def some(kind: str = "bytes") -> str:
            return self.expression(kind, depth)

        return (
            lambda: f"({some()} + {some()})",
            lambda: f"{some()}[{self.bound(depth)}:{self.bound(depth)}]",
            lambda: f"{some('str')}.encode()",
            lambda: (
                f"({some('int')}{self.or_risky(' % 100', '')})"
                f".to_bytes({self.pick(['1', '8', '33'])}, 'big', signed={some('bool')})"
            ),
            lambda: f"bytes([x % 256 for x in {some('ints')}])",
            lambda: f"bytes({some('int')} % 9)",
            lambda: f"bytes.fromhex({self.or_risky(some() + '.hex()', some('str'))})",
            lambda: f"{some()}.replace({some()}[:2], {some()})",
            lambda: f"u32({some('int')}{self.or_risky(' % 77777', '')})",
        )[self.random.randrange(9)]()

    def of_bool(self, depth: int) -> str:
        def some(kind: str) -> str:
            return self.expression(kind, depth)

        kind = self.pick(["int", "str", "bytes"])
        orders = ["<", "<=", ">", ">=", "==", "!="]
        return (
            lambda: f"({some(kind)} {self.pick(orders)} {some(kind)})",
            lambda: f"({some('int')} {self.pick(orders)} {some('int')} {self.pick(orders)} {some('int')})",
            lambda: f"({some('bool')} {self.pick(['and', 'or'])} {some('bool')})",
            lambda: f"(not {some(self.pick(list(TYPES)))})",
            lambda: f"({some('int')} {self.pick(['in', 'not in'])} {some('ints')})",
            lambda: f"({some('str')} {self.pick(['in', 'not in'])} {some(self.pick(['str', 'strs', 'table']))})",
            lambda: f"(({some('int')} % 256) in {some('bytes')})",
            lambda: f"({some('ints')} == {some('ints')})",
            lambda: f"({some('table')} {self.pick(['==', '!='])} {some('table')})",
            lambda: f"{self.pick(['any', 'all'])}(x > 1 for x in {some('ints')})",
            lambda: f"({some('str')}){self.pick(TEXT_TESTS)}",
            lambda: f"{some('str')}.{self.pick(['startswith', 'endswith'])}({some('str')})",
            lambda: f"isinstance({some(self.pick(list(TYPES)))}, {self.pick(KINDS)})",
            lambda: f"({some(self.pick(list(TYPES)))} is {self.pick(['', 'not '])}None)",
            lambda: f"({some('int')} in range({some('int')} % 99, {some('int')} % 99, {self.pick(['1', '2', '-3'])}))",
        )[self.random.randrange(15)]()

    def of_ints(self, depth: int) -> str:
        def some(kind: str = "ints") -> str:
            return self.expression(kind, depth)

        return (
            lambda: f"[{some('int')}, {some('int')}]",
            lambda: f"({some()} + {some()})",
            lambda: f"{some()}[{self.bound(depth)}:{self.bound(depth)}]",
            lambda: (
                f"[x {self.pick(['^', '&', '|'])} {some('int')} for x in {some()}"
                f" if x {self.pick(['>', '!='])} {some('int')}]"
            ),
            lambda: f"list(range({some('int')} % 9))",
            lambda: f"{self.pick(['sorted', 'reversed', 'list'])}({some()})",
            lambda: f"sorted({some()}, reverse={some('bool')})",
            lambda: f"list({some('bytes')})",
            lambda: f"[len(x) for x in {some('strs')}]",
            lambda: f"{some('table')}.values()",
            lambda: f"[i | n for i, n in enumerate({some()}, {some('int')} >> 1)]",
            lambda: f"[a ^ b for a, b in zip({some()}, {some()})]",
        )[self.random.randrange(12)]()

    def of_strs(self, depth: int) -> str:
        def some(kind: str = "strs") -> str:
            return self.expression(kind, depth)

        return (
            lambda: f"[{some('str')}, {some('str')}]",
            lambda: f"({some()} + {some()})",
            lambda: f"{some('str')}.split({some('str')}{self.or_risky(' + chr_'.replace('chr_', repr(',')), '')})",
            lambda: f"{some('str')}.split()",
            lambda: f"sorted({some()})",
            lambda: f"{some('table')}.keys()",
            lambda: f"list({some('str')})",
            lambda: f"[k + str(n) for k, n in {some('table')}.items()]",
        )[self.random.randrange(8)]()

    def of_table(self, depth: int) -> str:
        def some(kind: str = "table") -> str:
            return self.expression(kind, depth)

        return (
            lambda: f"{{{some('str')}: {some('int')}, {some('str')}: {some('int')}}}",
            lambda: f"{{k: len(k) for k in {some('strs')}}}",
            lambda: f"{{str(x): x for x in {some('ints')} if {some('bool')}}}",
            lambda: f"dict([('k', {some('int')}), ({some('str')}, 2)])",
            lambda: f"{some()}.copy()",
            lambda: f"state.get(b'table', {some()})",
        )[self.random.randrange(6)]()

    def statements(self, count: int, depth: int, indent: str) -> list[str]:
        lines: list[str] = []
        for _ in range(count):
            lines += self.statement(depth, indent)
        return lines

    def statement(self, depth: int, indent: str) -> list[str]:
        choice = self.random.randrange(24)
        if depth > 0 and choice < 5:
            return self.block(choice, depth, indent)
        if choice >= 18:
            return self.phrase(depth, indent) if choice < 23 or depth == 0 else self.phrase_block(depth, indent)
        if choice < 9:
            kind = self.pick(TYPES)
            value = self.expression(kind, 3)
            name = self.pick(self.named(kind)) if self.named(kind) and self.chance(2) else self.fresh()
            note = f": {ANNOTATIONS.get(kind, kind)}" if self.chance(4) else ""
            self.variables[name] = kind
            return [f"{indent}{name}{note} = {value}"]
        simple = self.simple(choice - 9)
        return [indent + line for line in simple.split("\n")] if simple else self.statement(0, indent)

    def phrase(self, depth: int, indent: str) -> list[str]:
        """Return a statement of the phrases; now and then a `return`, where the function may go on without it."""
        if self.chance(12):
            return [
                f"{indent}if {self.expression('bool', 2)}:",
                f"{indent}    return {self.expression(self.result, 2)}",
            ]
        phrase = self.pick(STATEMENTS)
        lines = []
        for kind in re.findall(r"\{(\w+)!\}", phrase):
            if kind != "any" and not self.named(kind):
                name = self.fresh()
                lines.append(f"{indent}{name} = {self.expression(kind, 1)}")
                self.variables[name] = kind
        return [*lines, indent + self.filled(self.unless_any(phrase), min(depth, 2))]

    def unless_any(self, phrase: str) -> str:
        """`{any!}` is assigned to: of one type on both sides, and a name that there is."""
        return phrase.replace("{any!}", f"{{{self.variables[self.pick(list(self.variables))]}!}}")

    def phrase_block(self, depth: int, indent: str) -> list[str]:
        before = dict(self.variables)
        head = self.pick(BLOCKS)
        targets = head.split(" in ")[0] if head.startswith("for") else ""
        for kind in re.findall(r"\{(\w+)!\}", targets):
            name = self.fresh("i")
            targets = targets.replace(f"{{{kind}!}}", name, 1)
            self.variables[name] = kind
        rest = head.partition(" in ")[2]
        shown = {name: kind for name, kind in self.variables.items() if name in before}
        inside, self.variables = self.variables, shown
        line = self.filled(f"{targets} in {rest}" if targets else head, 2)
        self.variables = inside
        lines = [indent + line, *self.loop_body(depth, indent + "    ", loop=bool(targets))]
        self.forget(before)
        return lines

    def simple(self, choice: int) -> str:
        ints, strs, tables, numbers = self.named("ints"), self.named("strs"), self.named("table"), self.named("int")
        value = self.expression("int", 2)
        if choice == 0 and ints:
            name = self.pick(ints)
            return name + self.pick(
                [f".append({value})", self.or_risky(".copy()", f".pop({value})"), f".insert({value}, {value})",
                 self.or_risky(".reverse()", f".remove({value})"), self.or_risky(".reverse()", ".pop()"),
                 ".sort()", ".sort(reverse=True)", f".extend({name})",
                 self.or_risky(" += [1]", f"[0] = {value}"), self.or_risky(" += [2]", f"[-1] ^= {value}"), ".clear()"]
            )  # fmt: skip
        if choice == 1 and ints:
            name = self.pick(ints)
            return f"if len({name}) > {self.or_risky('1', '0')}:\n    del {name}[{self.pick(['0', '-1', '1'])}]"
        if choice == 2 and tables:
            name, key = self.pick(tables), self.expression("str", 1)
            return self.pick(
                [f"{name}[{key}] = {value}", self.or_risky(f"{name}.clear()", f"{name}[{key}] ^= {value}"),
                 self.or_risky(f"{name}.copy()", f"del {name}[{key}]"), self.or_risky("pass", f"{name}.pop({key})"),
                 f"{name}.pop({key}, 0)", f"{name}.setdefault({key}, {value})",
                 f"{name}.update({self.expression('table', 1)})"]
            )  # fmt: skip
        if choice == 3 and numbers:
            sign = self.pick(["+=", "-=", "//=", "%=", "&=", ">>=", "*="])
            return f"{self.pick(numbers)} {sign} {self.or_risky('(' + value + ' & 7 | 1)', value)}"
        if choice == 4 and strs:
            return f"{self.pick(strs)}.append({self.expression('str', 2)})"
        if choice == 5:
            return f"state.put({self.pick(BYTES)} + b'k', {self.expression(self.pick(TYPES), 2)})"
        if choice == 6:
            return f"emit('e{self.random.randrange(3)}', {{'v': {self.expression(self.pick(TYPES), 2)}}})"
        if choice == 7:
            condition = self.or_risky("True", self.expression("bool", 2))
            return f"require({condition} or {self.expression('bool', 1)}, 'NO_{self.random.randrange(5)}')"
        one, other = self.fresh(), self.fresh()
        pair = f"{one}, {other} = {value}, {self.expression('int', 1)}"
        self.variables[one] = self.variables[other] = "int"
        return pair

    def block(self, choice: int, depth: int, indent: str) -> list[str]:
        inner = indent + "    "
        before = dict(self.variables)
        lines: list[str] = []
        if choice == 0:
            lines = [f"{indent}if {self.expression('bool', 2)}:", *self.statements(2, depth - 1, inner)]
            self.forget(before)
            if self.chance(2):
                lines += [f"{indent}elif {self.expression('bool', 1)}:", *self.statements(1, depth - 1, inner)]
                self.forget(before)
            if self.chance(2):
                lines += [f"{indent}else:", *self.statements(1, depth - 1, inner)]
        elif choice in (1, 2):
            name = self.fresh("i")
            source = self.pick([self.expression("ints", 2), f"range({self.random.randrange(5)})", "[1, 2, 3]"])
            self.variables[name] = "int"
            lines = [f"{indent}for {name} in {source}:", *self.loop_body(depth, inner)]
        elif choice == 3:
            key, value = self.fresh("k"), self.fresh("n")
            self.variables |= {key: "str", value: "int"}
            table = self.expression("table", 2)
            lines = [f"{indent}for {key}, {value} in {table}.items():", *self.loop_body(depth, inner)]
        else:
            name = self.fresh("w")
            lines = [
                f"{indent}{name} = 0",
                f"{indent}while {name} < {self.random.randrange(4)}:",
                f"{inner}{name} += 1",
            ]
            lines += self.loop_body(depth, inner)
        self.forget(before)
        return lines

    def loop_body(self, depth: int, inner: str, *, loop: bool = True) -> list[str]:
        lines = self.statements(2, depth - 1, inner)
        if loop and self.chance(3):
            lines += [f"{inner}if {self.expression('bool', 2)}:", f"{inner}    {self.pick(['break', 'continue'])}"]
        return lines

    def forget(self, before: dict[str, str]) -> None:
        """What a branch or loop assigned first may have no value behind it."""
        self.maybe += [name for name, kind in self.variables.items() if name not in before and kind == "int"]
        self.variables = {name: kind for name, kind in self.variables.items() if name in before}

    def function(self, name: str, kinds: list[str], result: str, size: int) -> list[str]:
        self.variables = {f"p{place}": kind for place, kind in enumerate(kinds)}
        self.maybe = []
        self.result = result
        entry = name == "f"
        params = ", ".join(f"p{place}: {ANNOTATIONS.get(kind, kind)}" for place, kind in enumerate(kinds))
        head = ["@export"] if entry else []
        body = self.statements(size, 2, "    ")
        parts = [self.expression(result, 2)]
        if entry:
            parts += [name for name in self.variables if not self.chance(3)]
        answer = f"[{', '.join(parts)}]" if entry else parts[0]
        return [*head, f"def {name}({params}):", *body, f"    return {answer}", ""]

    def program(self) -> str:
        lines = HEAD.split("\n")
        self.helpers.append(("note", ["int"], "int"))
        for _ in range(self.random.randrange(3)):
            kinds = [self.pick(TYPES) for _ in range(self.random.randrange(1, 4))]
            name, result = self.fresh("h"), self.pick(TYPES)
            lines += self.function(name, kinds, result, 2)
            self.helpers.append((name, kinds, result))
        return "\n".join(lines + self.function("f", ["int", "str", "ints", "table"], self.pick(TYPES), 5)) + "\n"
