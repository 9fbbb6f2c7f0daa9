"""One hostile program and the outcome it must come to."""

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
    """A contract, the call of its entry, and what must come of it.

    `expect` is `refused:CODE` (a diagnostic among those the checker gives), or the codes of the call's outcome
    (`A|B`); "OK" where the attack runs and achieves nothing. `others` are sources of further contracts, `state` what is
    stored under the contract's own keys beforehand. `mode` is how the entry is called.
    `at_once`: one step asks for more than any call has, so that the gas is taken and nothing is done.
    `blocks_before`: the arguments of the calls of `f` that were made before, by blocks that are not final; the last of
    them are earlier calls of the same block.
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
    """Return a program whose entry `f` has this body; its parameters are a, b, c ... as many as there are `args`."""
    params = ", ".join(f"{letter}: object" for letter in "abcdef"[: len(more.get("args", ()))])
    inner = textwrap.indent(textwrap.dedent(text).strip("\n"), "    ")
    return Program(name, expect, f"{before}\n@export\ndef f({params}):\n{inner}\n", **more)


def bomb(name: str, text: str) -> Program:
    """Return a program that asks for more than there is in one step."""
    return body(name, SPENT, text, at_once=True)


def refused(name: str, code: str, text: str) -> Program:
    """Return a program whose entry has this body, and which the checker must refuse with a diagnostic of this code."""
    return body(name, REFUSED + code, text)


def source(name: str, expect: str, text: str, **more: Any) -> Program:
    """Return a program with this whole source, called at `f`."""
    return Program(name, expect, text, **more)
