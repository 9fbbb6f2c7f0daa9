"""One hostile program and its expected outcome."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from consensus.limits import CALL_GAS_MAX

REFUSED = "refused:"
"""How an expected outcome begins where the checker must refuse the source: then follows the diagnostic's code."""


SPENT = "OUT_OF_GAS|MEMORY_BUDGET"
"""Expected where which of the two budgets ends a program is a matter of prices."""


@dataclass(frozen=True, slots=True)
class Program:
    """A contract, its entry's call and the expected outcome.

    `expect`: `refused:CODE`, or outcome codes (`A|B`; "OK": runs, achieves nothing). `others`: further contracts'
    sources. `state`: stored beforehand. `mode`: how the entry is called. `at_once`: one step exceeds any budget.
    `blocks_before`: arguments of earlier calls of `f` by unfinalized blocks; the last are of the same block.
    """

    name: str
    expect: str
    source: str
    args: tuple[Any, ...] = ()
    others: Mapping[str, str] = field(default_factory=dict)
    state: Mapping[bytes, Any] = field(default_factory=dict)
    gas: int = CALL_GAS_MAX
    mode: str = "export"
    at_once: bool = False
    blocks_before: tuple[tuple[tuple[Any, ...], ...], ...] = ()


def body(name: str, expect: str, text: str, *, before: str = "", **more: Any) -> Program:
    """The body of entry `f`, parameters a, b, c ... per `args`."""
    params = ", ".join(f"{letter}: object" for letter in "abcdef"[: len(more.get("args", ()))])
    inner = textwrap.indent(textwrap.dedent(text).strip("\n"), "    ")
    return Program(name, expect, f"{before}\n@export\ndef f({params}):\n{inner}\n", **more)


def spent(name: str, text: str, **more: Any) -> Program:
    return body(name, SPENT, text, **more)


def forever(name: str, setup: str, step: str, repeats: int, **more: Any) -> Program:
    """A loop without end of a step's lines, written `repeats` times."""
    lines = "\n".join([step] * repeats).replace("\n", "\n    ")
    return spent(name, f"{setup}\nwhile True:\n    {lines}", **more)


def bomb(name: str, text: str) -> Program:
    return spent(name, text, at_once=True)


def refused(name: str, code: str, text: str) -> Program:
    return body(name, REFUSED + code, text)


def source(name: str, expect: str, text: str, **more: Any) -> Program:
    return Program(name, expect, text, **more)
