"""Breeds programs towards maximal CPU time per gas."""

# ruff: noqa: E501 - tables of short templates read better in long lines

from __future__ import annotations

import gc
import random
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from contracts.vm.builtins.methods import METHODS
from contracts.vm.frontend.name_binding import CALLABLES
from network.lab.hostile.grammar import FUNCTIONS, SIGNS
from network.lab.hostile.measuring import Price, measure_program
from network.lab.hostile.micro import HELPERS, HOST_OTHER, MIXED_CONSTANTS, STATE
from network.lab.hostile.program import Program, forever

TRIAL_GAS = 150_000
SURE_GAS = 250_000
"""What a call has."""
SURE_ROUNDS_COUNT = 7
REPORTED_COUNT = 12
REFERENCE = forever("reference", "", "pass", 8)
KEPT_COUNT = 60
REPEATS_COUNT = 4
SIZES = (
    0,
    1,
    2,
    8,
    40,
    63,
    64,
    65,
    100,
    127,
    128,
    256,
    257,
    600,
    1024,
    2000,
    2499,
    2500,
    6000,
    29_000,
    30_000,
    100_000,
)
LETTERS = (
    "a",
    "b",
    "\\x00",
    "\\xe9",
    "\\xe8",
    "\\u0161",
    "\\u20ac",
    "\\u4e61",
    "\\U0001f600",
    "\\U0001f661",
    " ",
    "1",
    "A",
)
TEXTS = (
    "'{a}' * {n}", "'{a}' * {n} + '{b}'", "'{b}' + '{a}' * {n}", "'{a}{b}' * {n}", "'{a}' * ({n} // 2) + '{b}' + '{a}' * ({n} // 2)",
    "'{a}' * {n} + '\\U0001f600'", "'{a}{b}{c}' * ({n} // 3)", "'{c}'", "'{a}{b}'",
)  # fmt: skip
BYTES = (*("b" + text.replace(" + '", " + b'") for text in TEXTS if "U0001" not in text), "bytes({n})", "u64({n})")
MIXED_TEXTS = ("MIXED[:{n}]", "MIXED[:{n}] + '{a}'", "MIXED_WIDTHS[:{n}]")
MIXED_BYTES = (
    "MIXED.encode()[:{n}]",
    "MIXED_WIDTHS.encode()[:{n}]",
    "b''.join([sha256(u64(i)) for i in range({n} // 32)])",
)
INTS = ("{n}", "-{n}", "2 ** 255 + {n}", "2 ** 59 + {n}", "-(2 ** 255) + {n}", "2 ** 127 + {n}", "7", "0", "1", "3")
ITEMS = (
    "[{n}] * {n}", "list(range({n}))", "[i * 7919 % 10007 for i in range({n})]", "[str(i) for i in range({n})]",
    "['{a}' * 9] * {n}", "['{a}' * 200 + str(i * 7919 % 10007) + '{b}' for i in range({n} // 40)]", "['{a}'] * {n}",
    "[b'{x}' * 200 + u64(i * 7919 % 10007) for i in range({n} // 40)]", "[2 ** 255 + i * 7919 % 10007 for i in range({n})]",
    "[[1, 2], [3]] * ({n} // 2)", "[{{'a': 1}}] * {n}", "[[[[[[1]]]]]] * ({n} // 4)", "[''] * {n}", "[b''] * {n}",
    "[(i, i) for i in range({n})]", "['{a}', '{b}'] * ({n} // 2)", "[[] for i in range({n})]", "[1, 2, 3]", "[{{}}] * {n}",
    "[None, True, False] * ({n} // 3)", "['{a}' * 120, '{a}' * 120] * ({n} // 2)", "[[b'{x}' * 40]] * {n}",
    "[i * i % 65537 % 2 for i in range({n})]", "[i * i % 65537 % 2 == 0 for i in range({n})]", "['{a}{b}'[i * i % 65537 % 2] for i in range({n})]",
)  # fmt: skip
DICTS = (
    "{{i: i for i in range({n})}}", "{{str(i): i for i in range({n})}}", "{{u64(i): i for i in range({n})}}",
    "{{i << 44: i for i in range({n})}}", "{{i * 4096: i for i in range({n})}}", "{{'{a}' * 1000 + str(i): i for i in range({n} // 20)}}",
    "{{'{a}' * 20 + str(i): '{b}' * 9 for i in range({n})}}", "{{str(i): {{'a': i}} for i in range({n} // 4)}}",
    "{{-i: [i] for i in range({n})}}", "{{'a': 1, 'b': [1, 2], 'c': b'x' * 33}}", "{{}}", "{{'n': {n}}}",
)  # fmt: skip
HOLES = "for i in list({v})[{keep} :]:\n    del {v}[i]"
TEMPLATES: dict[str, tuple[str, ...]] = {
    "s": TEXTS + MIXED_TEXTS, "b": BYTES + MIXED_BYTES, "i": INTS, "l": ITEMS, "t": tuple(f"tuple({items})" for items in ITEMS), "d": DICTS,
    "r": ("range({n})", "range(2 ** 59, 2 ** 59 + {n})", "range({n}, 0, -3)"),
}  # fmt: skip
TYPE_LETTERS: dict[type, str] = {str: "s", bytes: "b", int: "i", list: "l", tuple: "t", dict: "d", range: "r"}
SLOTS = ("s0", "s1", "s2", "b0", "b1", "b2", "i0", "i1", "l0", "l1", "t0", "t1", "d0", "d1", "r0")
CONSTRUCTS = (
    "y = {s}[{i} % 9]", "y = {l}[-1:]", "y = {s}[1:]", "y = {s}[{i} % 99 : {i} % 999]", "y = {b}[{i} % 99 :]", "y = {l}[{i} % 9 :]",
    "y = f'{{{s}}}{{{s}}}'", "y = f'{{{i}}}-{{{s}}}'", "for v in {any}:\n    pass", "for v in {d}:\n    break", "y = [v for v in {any}]",
    "y = {{v: 1 for v in {l}}}", "y = [v for v in {any} if v]", "y = any(v == {any} for v in {l})", "y = [{any}, {any}, {any}]",
    "y = ({any}, {any})", "y = {{'a': {any}, 'b': {any}}}", "y = {{{s}: {any}}}", "for v, w in {d}.items():\n    pass",
    "y = {any} if {any} else {any}", "y = not {any}", "y = -{i}", "y = ~{i}", "y = {any} is None", "y = isinstance({any}, str)",
    "y = call('other', 'f', {any})", "y = call('other', 'g')", "y = call('other', 'h', {l})", "x = h1({any})", "y = h4({any}, 1, 2, 3)",
    "y = {d}[{key}]", "{d}[{key}] = {any}", "{d}[{key}] = 1\ndel {d}[{key}]", "{l}[{i} % 9] = {any}", "{l}.append(1)\ndel {l}[0]",
    "y = CONSTANT", "y = {i} < {i} < {i}", "state.put(b'k', {any})", "y = state.get(b'{stored}')", "y = state.scan(b'{stored}', {few})",
    "y = [{any} + {any} for v in range(9)]", "y = sorted({l} + {l})", "y = {any} == {any}", "y = {s}.encode() + {b}", "y = {s} + {s}",
    "{d}[{key}] += 1", "{l}[0] += 1", "y = [v for v in {l} if v in {d}]", "y = [v for v in {d} if v in {d}]", "y = {s} * {few}",
)  # fmt: skip
ARGUMENTS: dict[str, tuple[str, ...]] = {
    "index": ("0", "-1", "{i}", "1"), "item": ("{any}", "1", "0"), "more": ("{l}", "{d}", "{r}", "{d}"), "key": ("{key}",),
    "default": ("{any}", "1"), "length": ("8", "33", "32"), "byteorder": ("'big'", "'little'"), "parts": ("{l}", "[{same}] * {few}", "{t}"),
    "values": ("{any}", "{l}", "{l}", "{r}"), "value": ("{any}",), "text": ("{s}", "{b}.hex()", "'00' * {few}"), "number": ("{i} & 255", "7"),
    "start": ("{i}", "0"), "stop": ("{i}", "9"), "step": ("1", "3"), "data": ("{b}",), "limit": ("{few}", "256"), "name": ("'done'",),
    "tag": ("'t'",), "signature": ("b'\\x01' * 65", "{b}"), "message": ("{b}",), "contract": ("'other'",), "fn": ("'f'",),
    "characters": ("{same}[:64]", "{same}[-1:]", "{same}"),
}  # fmt: skip
ONLY_BY_NAME = {"reverse": "reverse=True", "signed": "signed=True"}
_HOLE = re.compile(r"\{(s|b|i|l|t|d|r|any|key|few|stored|same)\}")
_SLOT = re.compile(r"\b[sbiltdr][012]\b")


@dataclass(frozen=True, slots=True)
class Value:
    """One value's construction: template, letters, size, remaining dict entries."""

    template: str
    letters: tuple[str, str, str]
    size: int
    kept: int | None = None

    def lines(self, name: str) -> str:
        one, other, third = self.letters
        made = self.template.format(a=one, b=other, c=third, n=self.size, x="x")
        if self.template.startswith("b'"):
            made = re.sub(r"\\[uU][0-9a-f]+", "\\\\xff", made)
        return f"{name} = {made}" + ("" if self.kept is None else "\n" + HOLES.format(v=name, keep=self.kept))


@dataclass(frozen=True, slots=True)
class Genome:
    """A bred program: values by name, and steps."""

    values: tuple[tuple[str, Value], ...]
    steps: tuple[str, ...]

    def kind(self) -> frozenset[str]:
        text = " ".join(self.steps)
        return frozenset(re.findall(r"\.?[a-z_]+\(|\bin\b|[-+*/%<>=!&|^]{1,2}|\[.*?:|\bfor\b|f'", text))

    def program(self, name: str) -> Program:
        used = set(_SLOT.findall(" ".join(self.steps)))
        setup = "\n".join(value.lines(slot) for slot, value in self.values if slot in used)
        before = HELPERS + (MIXED_CONSTANTS if "MIXED" in setup else "")
        more = {"before": before, "others": {"other": OTHER}, "state": STATE}
        return forever(name, f"x = 0\ny = 0\n{setup}", "\n".join(self.steps), REPEATS_COUNT, **more)


OTHER = (
    HOST_OTHER + "\n\n@view\ndef h(x: list[int | str | bytes | list | dict | bool | None]) -> object:\n    return x\n"
)


class Breeder:
    """Draws, mutates and crosses genomes, deterministic by seed."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)  # noqa: S311 - a search is to be done again
        self._methods = [(name, kind) for name, table in sorted(METHODS.items()) for kind in table]
        self._functions = list(FUNCTIONS)

    def new(self) -> Genome:
        values = tuple((slot, self._value(slot)) for slot in SLOTS)
        return Genome(values, tuple(self.step() for _ in range(self.chance.choice((1, 1, 1, 2, 3)))))

    def _value(self, slot: str) -> Value:
        chance = self.chance
        letters = (chance.choice(LETTERS), chance.choice(LETTERS), chance.choice(LETTERS))
        kept = chance.choice((0, 1, 5, 100)) if slot[0] == "d" and chance.random() < 0.2 else None
        return Value(chance.choice(TEMPLATES[slot[0]]), letters, chance.choice(SIZES), kept)

    def step(self) -> str:
        kind = self.chance.randrange(10)
        if kind < 2:
            one, other = self.chance.choice(("{any}", "{s}", "{l}")), self.chance.choice(("{any}", "{s}", "{i}", "{l}"))
            return self._fill(f"y = {one} {self.chance.choice(SIGNS)} {other}")
        if kind < 6:
            name, owner = self.chance.choice(self._methods)
            method, letter = METHODS[name][owner], TYPE_LETTERS[owner]
            given = self._arguments(method.params, method.required, letter)
            return self._fill(f"y = {{{letter}}}.{name}({given})", letter)
        if kind < 8:
            name = self.chance.choice(self._functions)
            function = CALLABLES[name]
            given = self._arguments(function.params, function.required, "s")
            more = ", {any}" if function.variadic and self.chance.random() < 0.5 else ""
            return self._fill(f"y = {name}({given}{more})")
        return self._fill(self.chance.choice(CONSTRUCTS))

    def _arguments(self, params: tuple[str, ...], required: int, letter: str) -> str:
        count = self.chance.randint(required, len(params))
        return ", ".join(ONLY_BY_NAME.get(name) or self._argument(name, letter) for name in params[:count])

    def _argument(self, name: str, letter: str) -> str:
        return self.chance.choice(ARGUMENTS.get(name, ("{same}" if letter in "sb" else "{any}",)))

    def _fill(self, shape: str, same: str = "s") -> str:
        def fill(hole: re.Match[str]) -> str:
            wanted = same if hole[1] == "same" else hole[1]
            if wanted == "key":
                return self.chance.choice(("0", "'0'", "-5", "i0", "s1", "b1", "2 ** 44", "u64(0)"))
            if wanted == "few":
                return str(self.chance.choice((1, 3, 10, 100)))
            if wanted == "stored":
                return self.chance.choice(("int", "dict", "nested", "large", "wide", "s", "q"))
            slots = [slot for slot in SLOTS if wanted == "any" or slot[0] == wanted]
            return self.chance.choice(slots)

        return _HOLE.sub(fill, shape).replace("{{", "{").replace("}}", "}")

    def change(self, genome: Genome) -> Genome:
        chance = self.chance
        used = sorted(set(_SLOT.findall(" ".join(genome.steps))))
        for _ in range(chance.choice((1, 1, 2, 3))):
            kind = chance.randrange(10)
            if kind < 6 and used:
                slot = chance.choice(used)
                values = tuple(
                    (name, self._turn(name, value) if name == slot else value) for name, value in genome.values
                )
                genome = replace(genome, values=values)
            elif kind < 8:
                steps = list(genome.steps)
                steps[chance.randrange(len(steps))] = self.step()
                genome = replace(genome, steps=tuple(steps))
            elif kind == 8 and len(genome.steps) < 4:
                genome = replace(genome, steps=(*genome.steps, self.step()))
            elif len(genome.steps) > 1:
                place = chance.randrange(len(genome.steps))
                genome = replace(genome, steps=genome.steps[:place] + genome.steps[place + 1 :])
        return genome

    def _turn(self, slot: str, value: Value) -> Value:
        fresh, kind = self._value(slot), self.chance.randrange(5)
        if kind == 0:
            return fresh
        if kind == 1:
            return replace(value, letters=fresh.letters)
        if kind == 2:
            return replace(value, template=fresh.template)
        if kind == 3 and slot[0] == "d":
            return replace(value, kept=fresh.kept)
        if self.chance.random() < 0.5:
            return replace(value, size=fresh.size)
        return replace(value, size=min(max(int(value.size * self.chance.choice((0.3, 0.7, 1.5, 4))), 1), 200_000))

    def cross(self, one: Genome, other: Genome) -> Genome:
        values = tuple(self.chance.choice(pair) for pair in zip(one.values, other.values, strict=True))
        steps = tuple(self.chance.choice((one, other)).steps[0:2]) + tuple(self.chance.choice((one, other)).steps[0:1])
        return Genome(values, tuple(dict.fromkeys(steps)))


@dataclass(slots=True)
class Search:
    """Result of a search: programs made, those that used gas, dearest by kind.

    Prices are relative to the reference's time per million gas.
    """

    tried: int = 0
    counted: int = 0
    cpu_s: float = 0.0
    dearest: dict[frozenset[str], tuple[float, Genome]] = field(default_factory=dict)


def measure_reliably(program: Program, rounds: int, gas: int) -> Price | None:
    prices = [measure_program(program, rounds=1, gas_limit=gas) for _ in range(rounds)]
    return min(
        (price for price in prices if price is not None), key=lambda price: price.seconds_per_million_gas, default=None
    )


def _judge(genome: Genome, number: int, reference_s: float, beyond: float) -> float:
    program = genome.program(f"found-{number}")
    first = measure_reliably(program, 1, TRIAL_GAS)
    if first is None or first.code not in ("OUT_OF_GAS", "MEMORY_BUDGET"):
        return 0.0
    ratio = first.seconds_per_million_gas / reference_s
    if ratio < beyond:
        return ratio
    again, beside = measure_reliably(program, 3, TRIAL_GAS), measure_reliably(REFERENCE, 3, TRIAL_GAS)
    if again is None or beside is None:
        return 0.0
    return again.seconds_per_million_gas / beside.seconds_per_million_gas


def search(cpu_s: float, seed: int, on_progress: Callable[[str], None]) -> Search:
    breeder, done = Breeder(seed), Search()
    best = done.dearest
    gc.collect()
    gc.freeze()
    sure = measure_reliably(REFERENCE, SURE_ROUNDS_COUNT, TRIAL_GAS)
    assert sure is not None
    reference_s = sure.seconds_per_million_gas
    started = reported_s = time.process_time()
    while (spent := time.process_time() - started) < cpu_s:
        parents = [genome for _, genome in best.values()]
        kind = breeder.chance.random()
        if len(parents) < KEPT_COUNT // 4 or kind < 0.35:
            genome = breeder.new()
        elif kind < 0.85:
            genome = breeder.change(breeder.chance.choice(parents))
        else:
            genome = breeder.cross(breeder.chance.choice(parents), breeder.chance.choice(parents))
        done.tried += 1
        known = best.get(genome.kind(), (0.0, genome))[0]
        least = min(price for price, _ in best.values()) if len(best) >= KEPT_COUNT else 0.0
        price = _judge(genome, done.tried, reference_s, max(known, least))
        done.counted += price > 0
        if price > max(known, least):
            best[genome.kind()] = price, genome
            if len(best) > KEPT_COUNT:
                del best[min(best, key=lambda kind: best[kind][0])]
        if time.process_time() - reported_s > 30:
            reported_s = time.process_time()
            top = max((price for price, _ in best.values()), default=0.0)
            on_progress(
                f"{spent / 60:.1f} min of CPU time: {done.tried} programs, the dearest {top:.1f} times the reference (measured once)"
            )
    done.cpu_s = time.process_time() - started
    return done


def confirm(done: Search) -> list[tuple[Price, Program]]:
    ranked = sorted(done.dearest.values(), key=lambda pair: pair[0], reverse=True)[:REPORTED_COUNT]
    found: list[tuple[Price, Program]] = []
    for place, (_, genome) in enumerate(ranked):
        program = genome.program(f"found-{place + 1}")
        price = measure_reliably(program, SURE_ROUNDS_COUNT, SURE_GAS)
        if price is not None:
            found.append((price, program))
    return sorted(found, key=lambda pair: pair[0].seconds_per_million_gas, reverse=True)
