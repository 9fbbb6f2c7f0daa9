"""The golden vectors hold here, and between them they call everything the language has."""

from __future__ import annotations

import ast
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from contracts import vectors
from contracts.lifecycle.registry import SHIPPED_CONTRACTS
from contracts.vm import VM_CODES
from contracts.vm.builtins.host import CONTEXT_FIELDS
from contracts.vm.builtins.methods import METHODS
from contracts.vm.frontend.name_binding import CALLABLES, KINDS, dotted_name
from network.cli.main import main

FOLDER = Path(__file__).resolve().parent / "contracts"
DOCUMENTS = vectors.read_vectors(FOLDER)
ACCEPTED = set(
    re.findall(
        r"\w+",
        """
        Assign AnnAssign AugAssign Expr Return If For While Break Continue Delete Pass FunctionDef Constant Name BinOp
        UnaryOp BoolOp Compare IfExp Call Attribute Subscript Slice List Tuple Dict ListComp DictComp GeneratorExp
        JoinedStr FormattedValue Add Sub Mult FloorDiv Mod Pow LShift RShift BitAnd BitOr BitXor USub UAdd Invert Not
        And Or Eq NotEq Lt LtE Gt GtE In NotIn Is IsNot
        """,
    )
)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_call_ends_as_it_is_written_down(name):
    assert list(vectors.compare(DOCUMENTS[name])) == []


def sources() -> list[ast.Module]:
    found = [lines for document in DOCUMENTS.values() for lines in document.get("contracts", {}).values()]
    return [ast.parse("\n".join(lines)) for lines in found if lines is not None]


def nodes() -> list[ast.AST]:
    return [node for tree in sources() for node in ast.walk(tree)]


def outcomes() -> list[dict[str, Any]]:
    return [call["outcome"] for document in DOCUMENTS.values() for call in document["calls"]]


def test_every_construct_occurs():
    assert ACCEPTED - {type(node).__name__ for node in nodes()} == set()


def test_every_function_and_every_field_of_the_context_occurs():
    called = {dotted_name(node.func) for node in nodes() if isinstance(node, ast.Call)}
    read = {
        node.attr for node in nodes() if isinstance(node, ast.Attribute) and dotted_name(node) == f"ctx.{node.attr}"
    }
    assert (set(CALLABLES) - called, set(CONTEXT_FIELDS) - read) == (set(), set())


def test_every_kind_of_entry_occurs():
    modes = {call.get("mode", "export") for document in DOCUMENTS.values() for call in document["calls"]}
    assert modes == set(KINDS)


def test_every_method_of_every_type_is_called(monkeypatch):
    called: set[tuple[str, type]] = set()

    def noted(name, kind, run):
        def wrapped(runtime, *arguments):
            called.add((name, kind))
            return run(runtime, *arguments)

        return wrapped

    for name, table in METHODS.items():
        for kind, method in list(table.items()):
            monkeypatch.setitem(table, kind, replace(method, run=noted(name, kind, method.run)))
    for name in ("methods.json", "statements.json", "values.json"):
        vectors.play(DOCUMENTS[name])
    assert {(name, kind) for name, table in METHODS.items() for kind in table} - called == set()


def test_every_code_of_the_machine_occurs():
    assert VM_CODES - {outcome["code"] for outcome in outcomes()} == set()


def test_every_shipped_contract_is_called():
    called = {call["call"].split(".")[0] for document in DOCUMENTS.values() for call in document["calls"]}
    assert set(SHIPPED_CONTRACTS) - {"audit", "forms"} <= called


def test_writing_what_was_read_changes_nothing(tmp_path):
    vectors.write_vectors(DOCUMENTS, tmp_path)
    assert {path.name: path.read_text("utf-8") for path in tmp_path.iterdir()} == {
        path.name: path.read_text("utf-8") for path in FOLDER.iterdir()
    }


def vectors_command(*arguments: str | Path) -> Any:
    return CliRunner().invoke(main, ["contract", "vectors", *map(str, arguments)])


def test_the_command_says_that_all_is_well():
    result = vectors_command()
    assert (result.exit_code, "all are as they should be" in result.output) == (0, True)


def test_the_command_tells_a_difference_and_writes_it_down(tmp_path):
    document = json.loads((FOLDER / "values.json").read_text("utf-8"))
    document["calls"][2]["outcome"]["gas"] += 1
    vectors.write_vectors({"values.json": document}, tmp_path)
    result = vectors_command("--from", tmp_path, "--json")
    found = json.loads(result.output)
    assert (result.exit_code, found["ok"]) == (1, False)
    assert [row["call"] for row in found["files"][0]["differences"]] == ["2 it.e2"]
    told = vectors_command("--from", tmp_path).output
    assert "values.json: 2 it.e2" in told
    assert vectors_command("--from", tmp_path, "--write", tmp_path / "new").exit_code == 0
    assert (tmp_path / "new" / "values.json").read_text("utf-8") == (FOLDER / "values.json").read_text("utf-8")


def test_a_folder_without_vectors_is_told(tmp_path):
    result = vectors_command("--from", tmp_path, "--json")
    assert (result.exit_code, json.loads(result.output)["error"]["code"]) == (3, "VECTORS_MISSING")
