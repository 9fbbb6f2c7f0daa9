"""What random programs say beyond plain operators: expressions by type and statements, with holes for other expressions.

`{int}` is any expression of that type, `{ints!}` a variable of it. Between them they have every function, method, field,
operator and shape of the language; a test asks the machine.
"""

from __future__ import annotations

PHRASES: dict[str, tuple[str, ...]] = {
    "int": (
        "int.from_bytes({bytes}[:4])", "min({int}, 5, {int})", "zip({ints} + [4])[0][0]",
        "({int} >> 3).bit_length()", "int({bool})", "{bytes}.find({bytes})", "{bytes}.count({bytes})", "LIMIT",
        "sum(x for x in {ints} if x > 0 if x < 99)", "ctx.height", "(ctx.time + LIMIT)", "({int}, {int})[1]",
        "range(1, {int} % 9 + 2)[-1]", "range(3)[{int} % 3]", "{pair}[0]", "sorted({ints} + [1])[-1]",
        "max([x % 7 for x in {ints} + [0]])", "call('other', 'total', {ints}[:2])", "sum([len(x) for x in {grid}])",
        "({ints!}.pop() if {ints!} else {int})", "note({int})", "{ints!}[{int} % (len({ints!}) + 1) - 1]",
        "len(state.scan({key}, {int} % 5 + 1))", "min(x for x in {ints} + [7])", "({int} and {int} or {int})",
        "int.from_bytes({bytes}[:4], byteorder='little', signed={bool})", "{byint!}.pop({int}, {int})",
        "({int!}, {pair!}).index({int!})", "({int},)[0]", "(--{int} >> 2)", "({str} + 'q' + {str}).find('q')",
        "TABLE['a']", "WHOLE[0]", "{table!}.setdefault({str}, {int})", "len({pair} + (1,))", "min({pair}[0], {int})",
        "int({str} or '7')", "abs({int} >> 1) % 9", "u32({int} % 99)[3]", "spread()", "spread({int})",
        "spread({int}, {ints})", "spread(p1={ints})", "len({byint})", "bytes([{int} % 300, 0])[0]",
    ),
    "str": (
        "str()", "('' + state.get(key={key}, default={str}))",
        "str(None)", "min({strs} + ['b'])", "max({strs} + ['b', {str}])", "({str} + 'z')[-1]",
        "{str}.replace({str}, {str})", "{str}.strip({str})", "{str}.rstrip('a,')", "{str}.lstrip()", "ctx.contract",
        "(ctx.calling_contract + {str})", "{pair}[1]", "{byint}.get({int} % 9, {str})", "({str}, {str})[{int} % 2]",
        "','.join([str(x) for x in {ints}])", "''.join(k for k in {strs})", "({str} or {str})",
        "({bool} and {str} or 'no')", "f'{{LIMIT}}{{ctx.height}}'", "f'<{{str(1)}}{{2 + 3}}>' '{{}}'",
        "{bytes}.hex()[:6]", "(({int} % 4) * {str})", "{strs!}.pop(0)", "NAMES[0]", "[{str}][{int} % 3 - 1]",
        "call('other', 'echo', {str})", "b'caf\\xc3\\xa9'.decode()", "list({byint}.values() + ['v'])[0]",
    ),
    "bytes": (
        "u64({int} % 999)", "sha256({bytes})[:4]", "tagged_hash('t', {bytes})[-4:]", "{bytes}.join([{bytes}, b'-'])",
        "({bytes} * ({int} % 3))", "{bytes}.strip()", "{bytes}.lstrip({bytes})", "{bytes}.rstrip(b'a')",
        "ctx.caller[:3]", "ctx.txid[1:2]", "(ctx.chain + {bytes})[31:34]", "bytes()", "bytes({bytes})",
        "({int} % 200).to_bytes(3, 'little')", "({int} % 200).to_bytes(length=2)", "{bytes}.split(b'b')[0]",
        "min({bytes}, {bytes})", "sorted([{bytes}, {bytes}])[1]", "({bytes} or b'x')",
        "(state.scan(b'', 2) + [[{bytes}, 1]])[0][0]", "bytes.fromhex(' 0a FF')", "u32(number=7)",
        "({int} >> 250).to_bytes(1, 'big', signed=True)", "({int} % 3 * {bytes})", "{str}.encode()[:3]",
        "bytes(({int} % 256,))",
    ),
    "bool": (
        "{str}.isalpha()", "{str}.isalnum()", "{str}.isupper()", "{str}.islower()", "({str} + '1').isdigit()",
        "{str}.isascii()",
        "bool({any})", "({int} == {bool})", "({bool} in {ints})", "([{bool}] == [{int}])", "(({int},) == [{int}])",
        "({int} in ({int}, {str}, None))", "({pair} == {pair})", "({grid} != {grid})", "({ints} in {grid})",
        "({int} not in {byint})", "state.has({key})", "{bytes}.startswith({bytes})", "{bytes}.endswith({bytes})",
        "({bytes} in {bytes})", "({int} in {bytes})", "({int} in range({int} % 50))",
        "(1 < {int} <= {int} != 7 > 2)", "({str} < {str} < {str})", "(recover('t', {bytes}, {bytes}) is None)",
        "all([x for x in {strs}])", "any(({bool}, {bool}))", "({any} == {any})", "({bool} != {bool})",
        "(not {bool} or {bool} and {bool})", "(state.get({key}) is not None)", "isinstance({any}, tuple)",
        "isinstance({bytes}, bytes)", "({bool} is None)", "({table} == {byint})", "({byint} == {byint})",
        "(({int}, [{bool}]) in [({int}, [{bool}])])", "bool([])", "({int!} == {int!} == {bool})",
        "({int} < note({int}) < note({int}))", "('a' in {table} in [{table}])",
    ),
    "ints": (
        "list()", "list(tuple())",
        "list(({int}, {int}))", "{grid}[{int} % 2]", "[x for x in {ints} if x % 2 if x > 3]",
        "sorted({ints}, reverse=True)", "[x[0] for x in {grid} if x]", "list(range({int} % 5, {int} % 9))",
        "[a for a, b in {byint}.items()]", "{byint}.keys()", "[b for b in {bytes}]", "({ints} * ({int} % 3))",
        "list(tuple({ints}))", "[a % 9 + b + c for a, b, c in zip({ints}, range(9), {bytes})]",
        "reversed(range({int} % 6))", "call('other', 'echo', {ints})", "({ints} or {ints})", "list({byint})",
        "[x for x, y in enumerate({strs}, start={int} % 9)]", "[note(x % 9) for x in {ints}]", "sorted({byint})",
        "[i for i in {ints!}]", "[len(x) for x in [{ints!}, {ints!}] if {bool}]", "list(WHOLE)",
        "{ints}[{int} % 4:{int} % 7]", "list(reversed({bytes}))",
    ),
    "strs": (
        "NAMES", "(NAMES + {strs})", "{byint}.values()", "[s + t for s, t in zip({strs}, {str})]",
        "[c for c in {str}]", "list(('x', {str}))", "({strs} * ({int} % 3))", "[k for k in {table}]",
        "sorted({table})", "{strs!}[1:]", "[f'{{s}}{{i}}' for i, s in enumerate({strs})]", "reversed({str})",
        "{str}.split({str} or ' ')", "list({table})", "call('other', 'echo', {strs})",
        "[str(x) for x in ({int}, {bool}, None, {str})]",
    ),
    "table": (
        "{{'k': {int}}}", "dict({table})", "dict(zip({strs}, {ints}))",
        "{{k: n % 5 for k, n in {table}.items() if n if k}}", "TABLE", "call('other', 'echo', {table})", "dict()",
        "({table} or {table})", "{{s: i for i, s in enumerate({strs})}}", "dict({table}.items())",
        "{{{str}: note({int}), {str}: note({int})}}", "{{str(note(1)): note(2) for x in {ints}}}",
    ),
    "pair": (
        "({int}, {str})", "tuple([{int}, {str}])", "{pair}[0:2]", "({pair} + ())",
        "list({byint}.items() + [(1, 'b')])[0]", "({pair} * 1)", "({int}, {str},)", "enumerate({strs} + ['e'])[0]",
        "zip({ints} + [5], {strs} + ['f'])[0]", "({pair} or (0, ''))",
    ),
    "grid": (
        "state.get(b'grid', {grid})", "state.get(b'grid', {grid}).copy()",
        "[{ints}, {ints}]", "({grid} + [{ints}])", "[row + [{int}] for row in {grid}]",
        "[[a, len(b)] for a, b in {byint}.items()]", "({grid}[:1] + [[]])", "{grid}.copy()", "[[x] for x in {ints}]",
        "[x[:1] for x in {grid} if x if len(x) < 9]", "({grid}[:2] * 2)", "call('other', 'echo', {grid})",
        "list({grid})", "reversed({grid})", "[{ints!}, {ints!}]", "DEEP",
    ),
    "byint": (
        "state.get(b'byint', {byint})", "state.get(b'byint', {byint}).copy()",
        "{{{int} % 9: {str}, {int} % 5: {str}}}", "{{x % 7: str(x) for x in {ints}}}", "dict(enumerate({strs}))",
        "{byint}.copy()", "dict({byint})", "dict(zip(range(3), {strs}))", "{{-1: {str}, 2 ** 60 - 1: {str}}}",
    ),
}  # fmt: skip
STATEMENTS: tuple[str, ...] = (
    "state.put(b'grid', {grid})", "state.put(b'byint', {byint})", "state.put(b'table', {table})",
    "{grid!}.append({ints})", "{grid!}[0].append({int})", "{grid!}[0] = {ints}", "{grid!}[-1][0] = {int}",
    "{grid!} += [{ints}]", "{byint!}[{int} % 9] = {str}", "{byint!}[{int} % 9] += {str}", "{byint!}.update({byint})",
    "{byint!}.setdefault({int} % 9, {str})", "del {byint!}[{int} % 9]", "{table!}['a'] {sign} {int} % 9 + 1",
    "{ints!}[0] {sign} {int} % 9 + 1", "{int!} {sign} {int} % 9 + 1", "{str!} += {str}", "{bytes!} += {bytes}",
    "{ints!} += {ints}", "{ints!} *= {int} % 3", "{pair!} += ()", "{str!} *= {int} % 3", "{int!}, {str!} = {pair}",
    "{int!}, {int!} = {int!}, {int}", "state.delete({key})", "state.put({key}, {any})",
    "state.put(key={key}, value={any})", "emit(name='named', data={table})", "{int!} = {int!}", "{ints!} = {ints!}",
    "pass", "'a note'", "require({bool} or {bool}, 'NO_9', 'a sentence')",
    "require(condition={bool} or True, code='NO_8')", "{strs!}.sort()", "{strs!}.extend({str})",
    "{strs!}.insert(1, {str})", "{ints!}.extend(({int}, {int}))", "{strs!}.reverse()", "{ints!}.append(note({int}))",
    "{ints!}[note(0)] = note({int})", "{grid!}.sort()", "del {ints!}[0], {ints!}[-1]", "note({int})",
    "{ints!}.remove({int})", "{table!}.clear()", "{byint!}.pop({int} % 9)", "{ints!}.extend({bytes})",
    "call('other', 'keep', {any})", "state.put(b'it', state.scan(b'', 3))", "{pair!}[0] = 1", "{str!}[0] = 'a'",
    "{any!} = {any!}",
)  # fmt: skip
BLOCKS: tuple[str, ...] = (
    "for {int!} in {bytes}:", "for {str!} in {str}:", "for {str!} in {table}:", "for {ints!} in {grid}:",
    "for {int!} in {byint}:", "for {int!}, {str!} in enumerate({str}):", "for {int!} in ({int}, {int}):",
    "for {int!} in range({int} % 4, 9, {int} % 5 + 1):", "for {int!} in {ints!}:", "for {str!} in {table!}:",
    "if {int}:", "if {any}:", "if {bool} and {bool}:", "if not {bool}:", "for {int!}, {int!} in {grid}:",
    "for {str!}, {int!} in sorted({strs}):",
)  # fmt: skip
SIGNS = ("+=", "-=", "*=", "//=", "%=", "&=", "|=", "^=", ">>=", "<<=", "**=")
# Constants that every program has, a function with defaults (one of them a list, made anew each time), and one that
# shows the order in which arguments are computed.
HEAD = """\
LIMIT = 2 ** 8 - 1
NAMES = ['x', 'y']
TABLE = {'a': -LIMIT, 'b': 2}
WHOLE: tuple = (3, ~LIMIT)
DEEP = [[LIMIT], [], [1, 2] * 2]


def note(p0: int) -> int:
    emit('noted', {'v': p0})
    return p0


def spread(p0: int = LIMIT, p1: list = [1]) -> int:
    p1.append(p0)
    if len(p1) > 3:
        return p1[1]
    return len(p1)

"""
