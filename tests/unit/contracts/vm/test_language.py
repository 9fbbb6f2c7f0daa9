"""What each construct of the language means: mostly Python's meaning, and where not, the difference."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * 3 - 4 // 3", 6),
        ("-7 // 2", -4),
        ("-7 % 3", 2),
        ("2 ** 10", 1024),
        ("(-1) ** (2 ** 200)", 1),
        ("0 ** 0", 1),
        ("1 << 255 >> 254", 2),
        ("5 & 3 | 8 ^ 1", 9),
        ("~5", -6),
        ("0x10 + 1_000", 1016),
        ("1 < 2 <= 2 < 3", True),
        ("1 < 2 > 5", False),
        ("1 == True", False),
        ("0 == False", False),
        ("[1, {'a': (2,)}] == [1, {'a': (2,)}]", True),
        ("[1] == (1,)", False),
        ("not 0 and 'yes' or 'no'", "yes"),
        ("1 if [] else 2", 2),
        ("None is None", True),
        ("0 is not None", True),
        ("'b' in {'b': 1}", True),
        ("'ell' in 'hello'", True),
        ("b'l' not in b'hello'", False),
        ("104 in b'hello'", True),
        ("3 in range(0, 9, 3)", True),
        ("[3, 1, 2][-1]", 2),
        ("'hello'[1:3] + 'hello'[-2:]", "ello"),
        ("b'hello'[:2]", b"he"),
        ("b'hello'[0]", 104),
        ("[1, 2] * 2 + [3]", [1, 2, 1, 2, 3]),
        ("'ab' * 3", "ababab"),
        ("'' * (2 ** 255)", ""),
        ("'ab' * -1", ""),
        ("{'b': 1, 'a': 2, 3: 4, b'x': 5}", {"b": 1, "a": 2, 3: 4, b"x": 5}),
        ("(1, 'two', b'3')", [1, "two", b"3"]),
        ("[x * x for x in range(5) if x % 2]", [1, 9]),
        ("{k: v for k, v in [('a', 1), ('b', 2)]}", {"a": 1, "b": 2}),
        ("sum(x for x in [1, 2, 3])", 6),
        ("any([0, '', 3]) and all([])", True),
        ("f'{1 + 1} is {True} {None}'", "2 is True None"),
        ("f'{{}}'", "{}"),
        ("len('äö') + len(b'abc') + len({}) + len(range(10))", 15),
        ("sorted([3, 1, 2], reverse=True)", [3, 2, 1]),
        ("sorted(['b', 'a']) + reversed(['c', 'd'])", ["a", "b", "d", "c"]),
        ("min(3, 1, 2) + max([4, 5])", 6),
        ("abs(-3) + int('-12') + int(True)", -8),
        ("str(12) + str(None) + str(False)", "12NoneFalse"),
        ("enumerate(['a'], 5)", [[5, "a"]]),
        ("zip([1, 2], 'ab')", [[1, "a"], [2, "b"]]),
        ("list({'k': 1}) + list('xy') + list((1,))", ["k", "x", "y", 1]),
        ("dict([('a', 1)])", {"a": 1}),
        ("bytes([1, 2]) + bytes(2)", b"\x01\x02\x00\x00"),
        ("bytes.fromhex('00fF').hex()", "00ff"),
        ("int.from_bytes(b'\\x01\\x00') + int.from_bytes(b'\\x01\\x00', 'little')", 257),
        ("(258).to_bytes(4, 'big')", b"\x00\x00\x01\x02"),
        ("u32(1) + u64(2)", b"\x00\x00\x00\x01" + b"\x00" * 7 + b"\x02"),
        ("isinstance(True, int)", False),
        ("isinstance({}, dict)", True),
        ("'a,b,,c'.split(',')", ["a", "b", "", "c"]),
        ("'-'.join(['a', 'b'])", "a-b"),
        ("' x\\t'.strip() + 'xxyxx'.strip('x')", "xy"),
        ("'Straße'.upper() + 'ÄB'.lower()", "STRAßEÄb"),
        ("'é'.isalpha() or '1a'.isdigit()", False),
        ("'12'.isdigit() and 'aZ'.isalpha()", True),
        ("'abcabc'.replace('b', 'X', ) + str('abc'.find('c'))", "aXcaXc2"),
        ("'ä'.encode() + 'x'.encode()", "äx".encode()),
        ("b'\\xc3\\xa4'.decode()", "ä"),
        ("{'a': 1}.get('b', 7) + {'a': 1}.get('a')", 8),
        ("{'a': 1}.items()", [["a", 1]]),
        ("[1, 2, 1].index(2)", 1),
        ("2 ** 255 + (2 ** 255 - 1)", 2**256 - 1),
    ],
)
def test_an_expression_means(value, expression, expected):
    result = value(expression)
    assert result == expected
    assert type(result) is type(expected)


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + True", "TYPE_ERROR"),
        ("1 + 'a'", "TYPE_ERROR"),
        ("'%s' % 1", "TYPE_ERROR"),
        ("1 < 'a'", "TYPE_ERROR"),
        ("[1] < [2]", "TYPE_ERROR"),
        ("sorted([1, 'a'])", "TYPE_ERROR"),
        ("sorted([[1], [2]])", "TYPE_ERROR"),
        ("str([])", "TYPE_ERROR"),
        ("str(b'')", "TYPE_ERROR"),
        ("{(1,): 2}", "TYPE_ERROR"),
        ("{True: 2}", "TYPE_ERROR"),
        ("{2 ** 60: 2}", "VALUE_ERROR"),
        ("[] in {}", "TYPE_ERROR"),
        ("{}[[]]", "TYPE_ERROR"),
        ("{}['status']", "KEY_ERROR"),
        ("[][0]", "INDEX_ERROR"),
        ("''[-1]", "INDEX_ERROR"),
        ("[1]['a']", "TYPE_ERROR"),
        ("[1][True]", "TYPE_ERROR"),
        ("5[0]", "TYPE_ERROR"),
        ("[].pop()", "INDEX_ERROR"),
        ("{}.pop('a')", "KEY_ERROR"),
        ("[].index(1)", "VALUE_ERROR"),
        ("1 // 0", "ZERO_DIVISION"),
        ("1 % 0", "ZERO_DIVISION"),
        ("2 ** 256", "INT_OVERFLOW"),
        ("2 ** (2 ** 200)", "INT_OVERFLOW"),
        ("1 << 256", "INT_OVERFLOW"),
        ("1 << 2 ** 200", "INT_OVERFLOW"),
        ("(2 ** 255) * 2", "INT_OVERFLOW"),
        ("-(2 ** 255) - 2 ** 255", "INT_OVERFLOW"),
        ("2 ** -1", "VALUE_ERROR"),
        ("1 >> -1", "VALUE_ERROR"),
        ("int('1.5')", "VALUE_ERROR"),
        ("int('١')", "VALUE_ERROR"),
        ("int('9' * 79)", "VALUE_ERROR"),
        ("int('9' * 78)", "INT_OVERFLOW"),
        ("b'\\xff'.decode()", "VALUE_ERROR"),
        ("range(0, 1, 0)", "VALUE_ERROR"),
        ("bytes([256])", "VALUE_ERROR"),
        ("bytes(-1)", "VALUE_ERROR"),
        ("(-1).to_bytes(4)", "VALUE_ERROR"),
        ("u32(2 ** 32)", "VALUE_ERROR"),
        ("'a'.append(1)", "TYPE_ERROR"),
        ("(5).startswith('a')", "TYPE_ERROR"),
        ("'a'.split('')", "VALUE_ERROR"),
        ("max([])", "VALUE_ERROR"),
        ("len(5)", "TYPE_ERROR"),
        ("[x for x in 5]", "TYPE_ERROR"),
        ("range(3)", "TYPE_ERROR"),
    ],
)
def test_an_expression_fails_with(code, expression, expected):
    assert code(expression) == expected


def test_statements_do_what_python_does(run):
    body = """
total = 0
table: dict = {}
for i in range(10):
    if i == 3:
        continue
    elif i > 6:
        break
    else:
        total += i
    table[i] = [i]
    table[i] += [0]
while total > 10:
    total -= 4
del table[0]
first, second = [1, 2]
(first, second) = (second, first)
for key, pair in table.items():
    total += key * len(pair)
pass
return [total, first, second, sorted(table.keys())]
"""
    outcome = run(body.strip())
    total = 10 + 2 * (1 + 2 + 4 + 5 + 6)
    assert outcome.result == [total, 2, 1, [1, 2, 4, 5, 6]]


def test_loops_and_comprehensions_keep_to_themselves(run):
    assert run("d = {'a': 1}\nfor k in d:\n    d[k + 'x'] = 1\nreturn len(d)").result == 2
    assert run("x = 'outer'\ny = [x for x in range(3)]\nreturn [x, y]").result == ["outer", [0, 1, 2]]


def test_a_variable_without_a_value_is_named_also_behind_an_empty_loop(run):
    outcome = run("if a:\n    x = 1\nreturn x", False)
    assert (outcome.code, outcome.line) == ("NAME_UNSET", 6)
    assert "x" in outcome.message
    assert run("if a:\n    x = 1\nreturn x", True).result == 1
    assert run("for i in []:\n    pass\nreturn i").code == "NAME_UNSET"


def test_constants_are_computed_once_and_cannot_be_changed_for_the_next_call(bench):
    bench.deploy(
        "it",
        """
HOUR_MS = 60 * 60 * 1000
DAY_MS = 24 * HOUR_MS
LIST = [1, {"a": []}]

@export
def f() -> list:
    LIST.append(DAY_MS)
    LIST[1]["a"].append(2)
    mine = LIST
    mine.append(3)
    return mine
""",
    )
    assert [bench.call("it.f").result for _ in range(2)] == [[1, {"a": []}, 3]] * 2


def test_functions_take_defaults_and_names_and_may_call_each_other(run):
    before = """
def even(n, step=1):
    if n == 0:
        return True
    return odd(n - step, step=step)

def odd(n, step=1):
    if n == 0:
        return False
    return even(n=n - step, step=step)

def nothing(items=[]):
    items.append(1)
    return len(items)
"""
    assert run("nothing()\nreturn [even(10), odd(10, 2), nothing()]", before=before).result == [True, True, 1]


def test_arguments_go_from_left_to_right_and_and_and_or_stop_early(run):
    before = "def note(log, x):\n    log.append(x)\n    return x\n"
    assert run("log = []\nx = note(log, 1) + note(log, 2) * note(log, 3)\nreturn log", before=before).result == [
        1,
        2,
        3,
    ]
    assert run("x = a is None or a['k'] == 1\nreturn x", None).result is True
    assert run("x = helper()\nreturn x", before="def helper():\n    pass\n").result is None


def test_require_fails_with_the_authors_line_and_words_and_no_code_of_the_machine(run):
    outcome = run('require(a > 0, "NOT_POSITIVE", f"{a} is not positive.")\nreturn a', -1)
    assert (outcome.ok, outcome.code, outcome.message, outcome.line) == (
        False, "NOT_POSITIVE", "-1 is not positive.", 4,
    )  # fmt: skip
    assert run('require(a > 0, "NOT_POSITIVE")\nreturn a', 1).result == 1
    assert run("require(False, a)", "OUT_OF_GAS").code == "VALUE_ERROR"
    assert run("require(False, a)", "lower").code == "VALUE_ERROR"
    assert run("require(False, a)", "MINE").code == "MINE"


def test_a_value_that_holds_itself_is_stopped_wherever_it_goes(run):
    assert run("x = []\nx.append(x)\nreturn x").code == "VALUE_ERROR"
    assert run("x = []\nx.append(x)\ny = []\ny.append(y)\nreturn x == y").code == "VALUE_ERROR"
    assert run("x = []\nx.append(x)\nstate.put(b'k', x)").code == "VALUE_ERROR"


def test_the_line_of_a_failure_inside_a_helper_is_the_helpers(run):
    outcome = run("return helper(0)", before="def helper(n):\n    m = n\n    return 1 // m")
    assert (outcome.code, outcome.line) == ("ZERO_DIVISION", 3)
