"""Endless loops and unbounded recursion."""

from __future__ import annotations

from network.lab.hostile.program import Program, body, source, spent

_DOWN = "def down(n):\n    return down(n + 1) + 1\n"
_PAIR = "def even(n):\n    return odd(n + 1)\n\n\ndef odd(n):\n    return even(n + 1)\n"
_TREE = "def tree(n):\n    if n == 0:\n        return 1\n    return tree(n - 1) + tree(n - 1)\n"
_MANY = "\n\n".join(f"def f{n}(x):\n    return f{(n + 1) % 50}(x)\n" for n in range(50))

PROGRAMS: tuple[Program, ...] = (
    spent("loop-for-ever", "while True:\n    pass"),
    spent("loop-on-a-number", "while 1:\n    continue"),
    spent("loop-on-a-text", "x = 0\nwhile 'yes':\n    x += 1"),
    spent("loop-in-loop", "while True:\n    for i in range(10):\n        for j in range(10):\n            pass"),
    spent("loop-over-a-huge-range", "for i in range(2 ** 59):\n    pass"),
    spent("loop-over-a-growing-list", "x = [1]\nfor i in x:\n    x.append(i)"),
    spent("loop-over-a-list-put-before", "x = [1]\nfor i in x:\n    x.insert(0, i)"),
    spent("loop-over-a-refilled-list", "x = [1, 2]\nfor i in x:\n    x.pop(0)\n    x.append(1)\n    x.append(2)"),
    spent("loop-with-nothing-to-do", "for i in range(2 ** 59):\n    continue"),
    spent("loop-that-never-tests", "x = 1\nwhile x:\n    x = x ^ 3 ^ 1 if x > 5 else x + 1"),
    spent("comprehension-for-ever", "return [1 for i in range(2 ** 59) if i < 0]"),
    spent("dict-comprehension-for-ever", "return {1: i for i in range(2 ** 59) if not True}"),
    spent("comprehension-in-comprehension", "return sum(sum([j for j in range(1000)]) for i in range(2 ** 50))"),
    spent(
        "comprehension-grows-its-source", "x = [1]\ny = [x.append(1) for i in x if False or x.append(2) is not None]"
    ),
    spent("chained-comparison-for-ever", "while 0 < 1 < 2 < 3:\n    pass"),
    body("recursion", "CALL_DEPTH", "return down(0)", before=_DOWN),
    body("recursion-of-two", "CALL_DEPTH", "return even(0)", before=_PAIR),
    body("recursion-of-fifty", "CALL_DEPTH", "return f0(0)", before=_MANY),
    spent("recursion-as-a-tree", "return tree(30)", before=_TREE),
    body("recursion-in-an-argument", "CALL_DEPTH", "return g(1)", before="def g(n):\n    return max(1, g(n), 2)\n"),
    body(
        "recursion-in-a-comprehension",
        "CALL_DEPTH",
        "return g(1)",
        before="def g(n):\n    return [g(i) for i in [n]]\n",
    ),
    body("recursion-in-a-condition", "CALL_DEPTH", "return g(1)", before="def g(n):\n    require(g(n), 'NO_WAY')\n"),
    body("recursion-in-an-f-string", "CALL_DEPTH", "return g(1)", before="def g(n):\n    return f'{g(n)}'\n"),
    body("recursion-in-an-index", "CALL_DEPTH", "return g(1)", before="def g(n):\n    x = [0]\n    x[g(n)] += 1\n"),
    body(
        "recursion-with-large-frames",
        "CALL_DEPTH",
        "return g(1)",
        before="def g(n):\n" + "".join(f"    x{n} = n\n" for n in range(800)) + "    return g(n)\n",
    ),
    spent(
        "recursion-with-large-arguments",
        "while True:\n    g(bytes(100000), 40)",
        before="def g(x, n):\n    if n:\n        return g(x + b'1', n - 1)\n",
    ),
    source("recursion-through-an-entry", "CALL_DEPTH", "@export\ndef f():\n    return f()\n"),
    source("recursion-by-default", "CALL_DEPTH", "@export\ndef f(n: int = 0):\n    return f(n=n + 1)\n"),
    spent("calls-of-nothing", "while True:\n    g()", before="def g():\n    pass\n"),
    spent(
        "calls-of-many-arguments",
        "while True:\n    g(1, 2, 3, 4, 5, 6, 7, 8)",
        before="def g(a, b, c, d, e, h, i, j):\n    pass\n",
    ),
    body("gas-just-enough", "OK", "for i in range(10):\n    pass", gas=300),
    spent("gas-just-not-enough", "for i in range(10):\n    state.put(b'k', i)", gas=1000),
    spent("gas-none", "return 1", gas=0),
    spent("gas-one", "return 1", gas=1),
    spent("gas-gone-in-an-argument", "emit('a', {'x': [i for i in range(2 ** 40)]})"),
)
"""Endless work of every shape the language has."""
