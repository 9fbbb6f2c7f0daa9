"""The reference of the language names everything the language has, and its example works."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from contracts.vm import VM_CODES, find_problems
from contracts.vm.builtins.builtins_table import BUILTINS, TYPES
from contracts.vm.builtins.host import CONTEXT_FIELDS
from contracts.vm.builtins.methods import METHODS
from contracts.vm.frontend.name_binding import CALLABLES

REFERENCE = (Path(__file__).resolve().parents[4] / "docs" / "reference" / "contract-language.md").read_text("utf-8")


def test_every_function_method_type_field_and_code_is_described():
    words = set(re.findall(r"[\w.]+", REFERENCE))
    names = set(CALLABLES) | {f"ctx.{name}" for name in CONTEXT_FIELDS} | (set(VM_CODES) - {"OK"})
    assert names - words == set()
    rows = dict(re.findall(r"^\| `(\w+)` \| (`.*) \|$", REFERENCE.split("## Methods")[1].split("##")[0], re.MULTILINE))
    listed = {(name, kind) for kind, row in rows.items() for name in re.findall(r"`(\w+)", row)}
    assert listed == {(name, kind.__name__) for name, table in METHODS.items() for kind in table}
    values = section("Values")
    assert all(f"`{name}`" in values for name in TYPES)
    functions = set(re.findall(r"`([a-z0-9_.]+)\(", section("Functions")))
    assert set(BUILTINS) - {"require"} <= functions
    assert functions <= set(BUILTINS) | {"isinstance"}
    ledger = set(re.findall(r"`([a-z0-9_.]+)\(", section("The ledger")))
    assert set(CALLABLES) - set(BUILTINS) | {"require"} <= ledger


def test_the_example_works(bench):
    (source,) = re.findall(r"```python\n(.*?)```", REFERENCE, re.DOTALL)
    bench.deploy("counter", source)
    assert [bench.call("counter.raise_by", step).result for step in (3, 4)] == [3, 7]
    assert bench.call("counter.raise_by", 11).code == "STEP_WRONG"
    assert bench.call("counter.total", mode="view").result == 7


def section(title: str) -> str:
    return re.split(r"^##+ ", REFERENCE.split(f"# {title}\n")[1], maxsplit=1, flags=re.MULTILINE)[0]


def rows(title: str) -> dict[str, tuple[str, bool]]:
    """Return, by construct, its example as code and whether the language has it."""
    found: dict[str, tuple[str, bool]] = {}
    refused = False
    for line in section(title).split("\n"):
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if not cells:
            continue
        if cells[0] in ("Construct", "Operator", "Refused"):
            refused = cells[0] == "Refused" or "Why" in cells[2]
        name = re.fullmatch(r"`(\w+)`", cells[0])
        if name is not None:
            code = re.sub(r"^`|`$", "", cells[1].removeprefix("refused: ")).replace("\\|", "|")
            found[name[1]] = code.replace("\\n", "\n"), not refused and not cells[1].startswith("refused")
    return found


CONSTRUCTS = {**rows("Statements"), **rows("Expressions"), **rows("Operators")}
NEWER = {"TypeAlias", "TemplateStr", "Interpolation"}


def nodes_of(*bases: type[ast.AST]) -> set[str]:
    return {kind.__name__ for base in bases for kind in base.__subclasses__() if kind.__module__ == "ast"}


def test_every_node_of_the_syntax_and_every_diagnostic_is_explained_and_no_other():
    nodes = nodes_of(ast.stmt, ast.expr, ast.operator, ast.unaryop, ast.boolop, ast.cmpop)
    assert nodes - set(CONSTRUCTS) == set()
    assert set(CONSTRUCTS) - nodes <= NEWER
    table = section("Diagnostics").split("| Code |")[1]
    explained = {
        code for row in re.findall(r"^\| (`[^|]*) \|", table, re.MULTILINE) for code in re.findall(r"`(\w+)`", row)
    }
    assert explained == codes_that_are_reported()


def as_source(example: str) -> str:
    lines = "\n".join("    " + line for line in example.replace("; ", "\n").split("\n"))
    return f"@export\ndef f(a: int, b: int, items: list, x: object, pair: list):\n{lines}\n"


@pytest.mark.parametrize("name", [name for name, (example, _) in CONSTRUCTS.items() if name != "FunctionDef"])
def test_an_example_is_taken_or_refused_as_the_table_says(name):
    example, taken = CONSTRUCTS[name]
    statement = name in nodes_of(ast.stmt) or name == "TypeAlias" or example.startswith(("for ", "emit"))
    source = as_source(example if statement else f"x = {example}")
    problems = [one.code for one in find_problems(source, "it")]
    assert (problems == []) is taken, problems
    if taken:
        assert name in {type(node).__name__ for node in ast.walk(ast.parse(source))}


def codes_that_are_reported() -> set[str]:
    """Return every code that the checker, the pre-lexer, the reader and the command can put into a diagnostic."""
    found: set[str] = set()
    root = Path(__file__).resolve().parents[4]
    places = [
        root / "contracts/vm/frontend/lexer_guard.py",
        root / "contracts/vm/frontend/parser.py",
        root / "contracts/vm/frontend/checker.py",
        root / "contracts/vm/frontend/checker_expressions.py",
        root / "contracts/vm/compiler/compiled_contract.py",
        root / "network/cli/contract/contract_check_commands.py",
        root / "contracts/execution/chain_refusals.py",
    ]
    for place in places:
        for node in ast.walk(ast.parse(place.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.update(re.findall(r"^[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)*$", node.value))
    return found - {"AUGMENTED", "PLAIN", "LOOP", "RESERVED_NAMES", "ENTRIES_MAX_COUNT", "GOVERNING"}
