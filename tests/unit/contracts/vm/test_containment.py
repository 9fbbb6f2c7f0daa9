"""Sources that mean harm. Each is refused where it is deployed, or stopped with a code; none reaches Python."""

from __future__ import annotations

import time

import pytest

from contracts.vm import VM_CODES, ContractSourceError, compile_contract
from contracts.vm.builtins.methods import METHODS
from contracts.vm.frontend.name_binding import CALLABLES

ESCAPES = [
    "return ().__class__",
    "return ().__class__.__bases__[0].__subclasses__()",
    "return f.__globals__",
    "return f.__code__",
    "return ''.format_map({})",
    "return '{0.__class__}'.format(1)",
    "return f'{f.__globals__}'",
    "return (lambda: 0).__globals__",
    "import os",
    "from os import system",
    "return __import__('os')",
    "return __builtins__",
    "return eval('1')",
    "return exec('1')",
    "return compile('1', '', 'eval')",
    "return open('/etc/passwd')",
    "return getattr(1, 'real')",
    "return setattr(state, 'get', 1)",
    "return globals()",
    "return vars()",
    "return dir()",
    "return type(1)",
    "return id(1)",
    "return hash('a')",
    "return repr(1)",
    "return input()",
    "return breakpoint()",
    "return object()",
    "return super()",
    "return memoryview(b'a')",
    "return bytearray(5)",
    "return {1, 2}",
    "return frozenset()",
    "return 0.1 + 0.2",
    "return float('nan')",
    "return 1 / 3",
    "return 3j",
    "return print",
    "return [].append",
    "return state.get.__self__",
    "return ctx.__class__",
    "state.get = 1",
    "ctx.caller = b'x'",
    "global x\n    x = 1",
    "x = lambda: 1",
    "yield 1",
    "x = (y := 1)",
    "x = [*range(5)]",
    "f(*[1])",
    "f(**{'a': 1})",
    "assert 1",
    "raise ValueError",
    "try:\n        state.put(b'k', 1)\n    except:\n        pass",
    "with state:\n        pass",
    "class A:\n        pass",
    "async def g():\n        pass",
    "match 1:\n        case 1:\n            pass",
    "del state",
    "import sys; sys.exit()",
    "return '\\N{LATIN SMALL LETTER A}'",
    "return 1 if state.__dict__ else 2",
    "return call.__globals__['keys']",
    "return int.__subclasses__()",
    "return str.maketrans('a', 'b')",
    "return ''.translate({})",
    "return 'a'.__add__('b')",
    "return isinstance(1, object)",
    "return max([1], key=len)",
    "[].sort(key=f)",
    "return map(len, [])",
    "for f in [f]:\n        pass\n    return len.__self__",
]

STOPPED = [
    "while True:\n        pass",
    "x = 2\n    while True:\n        x = x * x",
    "x = '9' * 1000000\n    return int(x)",
    "return '\\uffff' * 100000000",
    "x = []\n    while True:\n        x = [x, x]",
    "x = {}\n    i = 0\n    while True:\n        x[i] = {}\n        i += 1",
    "return f()",
    "return [f() for i in range(10)]",
    "return sorted([str(i) for i in range(10 ** 6)])",
    "x = 'a' * 100000\n    while True:\n        y = x.find('a' * 1000 + 'b')",
    "x = 'é' * 10000\n    while True:\n        y = x.upper()",
    "x = ' ' * 100000\n    while True:\n        y = x.strip()",
    "x = [0] * 10000\n    while True:\n        x.insert(0, 1)",
    "x = [0] * 10000\n    while True:\n        y = 1 in x",
    "x = list(range(10000))\n    while True:\n        y = x[:]",
    "x = [[1]] * 1000\n    while True:\n        y = [2] in x",
    "while True:\n        x = 'a,b' .split(',')",
    "while True:\n        y = sha256(b'')",
    "while True:\n        y = recover('t', bytes(65), b'')",
    "while True:\n        y = state.scan(b'', 256)",
    "while True:\n        y = state.get(b'missing')",
    "x = [1]\n    for i in x:\n        x.append(i)",
    "x = (2 ** 255, ) * 1000\n    while True:\n        y = sum(list(x))",
    "x = {}\n    for i in range(10 ** 9):\n        x[i << 44] = i",
    "x = range(2 ** 59)\n    for i in x:\n        y = i",
    "x = 'a'\n    for i in range(100):\n        x = x.replace('a', 'aa')",
    "x = ['']\n    for i in range(100):\n        x = [''.join(x) + 'ab'] * 2",
    "x = b'x' * 16000\n    while True:\n        state.put(b'k', x)",
    "while True:\n        emit('e', {})",
    "x = []\n    for i in range(3000):\n        x = [x]\n    return x",
    "x = []\n    for i in range(3000):\n        x = [x]\n    return x == [x]",
    "x = {'a': 1}\n    x['x'] = x\n    emit('e', x)",
    "x = [1]\n    x.append(x)\n    return call('it', 'f', x)",
    "return -(-(2 ** 255) - 2 ** 255)",
    "return ~(2 ** 255 + (2 ** 255 - 1)) - 1",
    "return range(-2 ** 70, 2 ** 70)",
    "return bytes(10 ** 30)",
    "return [1, 2, 3][10 ** 50]",
    "return enumerate(range(2 ** 58))",
    "return zip(range(2 ** 58), range(2 ** 58))",
    "return (1).to_bytes(10 ** 9)",
    "return int.from_bytes(bytes(100))",
]


@pytest.mark.parametrize("body", ESCAPES)
def test_what_would_reach_python_is_refused_where_it_is_deployed(body):
    with pytest.raises(ContractSourceError) as caught:
        compile_contract(f"@export\ndef f():\n    {body}\n", "it")
    assert all(one.line >= 1 for one in caught.value.diagnostics)


@pytest.mark.parametrize("body", STOPPED)
def test_what_would_run_for_ever_is_stopped_by_a_code_with_a_line_and_in_time(bench, body):
    bench.deploy("it", f"@export\ndef f():\n    {body}\n")
    started = time.thread_time()
    outcome = bench.call("it.f")
    spent = time.thread_time() - started
    assert not outcome.ok
    assert outcome.code in VM_CODES
    assert outcome.line is not None or "result" in outcome.message
    assert outcome.gas_used <= bench.gas_limit
    assert spent < 1, "250,000 gas are meant to be a few hundredths of a second"


def test_no_name_a_contract_can_call_is_a_dunder_or_a_known_gadget():
    names = {name.split(".")[-1] for name in CALLABLES} | set(METHODS)
    assert not {name for name in names if name.startswith("_")}
    assert not names & {"format", "format_map", "translate", "maketrans", "eval", "exec", "getattr", "type", "object"}


def test_the_values_that_leave_a_call_are_plain(bench):
    bench.deploy("it", "@export\ndef f() -> list:\n    return [(1, True), {'k': (b'x', None)}, 'text']\n")
    result = bench.call("it.f").result

    def kinds(value: object) -> set[type]:
        inside = value if isinstance(value, list) else list(value.values()) if isinstance(value, dict) else []
        return {type(value)}.union(*[kinds(item) for item in inside])

    assert kinds(result) <= {list, dict, int, bool, str, bytes, type(None)}
