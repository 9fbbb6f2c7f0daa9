"""The reference of the language names everything the language has, and its example works."""

from __future__ import annotations

import re
from pathlib import Path

from contracts.vm import VM_CODES
from contracts.vm.host import CONTEXT_FIELDS
from contracts.vm.methods import METHODS
from contracts.vm.names import CALLABLES

REFERENCE = (Path(__file__).resolve().parents[4] / "docs" / "reference" / "contract-language.md").read_text("utf-8")


def test_every_function_field_and_code_is_described():
    words = set(re.findall(r"[\w.]+", REFERENCE))
    names = set(CALLABLES) | {f"ctx.{name}" for name in CONTEXT_FIELDS} | (set(VM_CODES) - {"OK"})
    assert names - words == set()


def test_every_method_is_listed_with_its_type():
    rows = dict(re.findall(r"^\| `(\w+)` \| (`.*) \|$", REFERENCE.split("## Methods")[1].split("##")[0], re.MULTILINE))
    listed = {(name, kind) for kind, row in rows.items() for name in re.findall(r"`(\w+)", row)}
    assert listed == {(name, kind.__name__) for name, table in METHODS.items() for kind in table}


def test_the_example_works(bench):
    (source,) = re.findall(r"```python\n(.*?)```", REFERENCE, re.DOTALL)
    bench.deploy("counter", source)
    assert [bench.call("counter.raise_by", step).result for step in (3, 4)] == [3, 7]
    assert bench.call("counter.raise_by", 11).code == "STEP_WRONG"
    assert bench.call("counter.total", mode="view").result == 7
