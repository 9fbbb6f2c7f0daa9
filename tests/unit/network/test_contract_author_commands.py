"""`contract new` and `contract test`: a contract begins as something that works, and what its tests ran is shown."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from contracts.kit import template
from contracts.kit.template import read_dialect_stub
from contracts.vm.frontend.name_binding import RESERVED
from network.cli.contract.contract_author_commands import ranges
from network.cli.contract.contract_commands import contract

EXAMPLES = Path(__file__).resolve().parents[3] / "docs" / "examples"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(contract, list(arguments))


def outcome_of(*arguments: str) -> dict[str, Any]:
    result = run("test", *arguments, "--json")
    document: dict[str, Any] = json.loads(result.stdout)
    assert result.exit_code == (0 if document["ok"] else 1)
    return document


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.chdir(tmp_path)
    assert run("new", "notes").exit_code == 0
    return tmp_path / "notes"


def test_a_new_contract_works_and_its_tests_run_every_line(project: Path) -> None:
    document = outcome_of("notes")
    assert (document["ok"], "4 passed" in document["output"]) == (True, True)
    (source,) = document["sources"]
    assert (source["contract"], source["file"]) == ("notes", str(project / "notes.py"))
    assert (source["missing"], source["covered"]) == ([], source["lines_count"])
    entries = {entry["name"]: entry for entry in source["entries"]}
    assert set(entries) == {"write", "read", "erase"}
    assert entries["write"]["calls"] == 2
    assert sum(line["gas"] for line in source["lines"]) > sum(entry["gas_max"] for entry in entries.values())


def test_lines_that_no_test_ran_and_those_of_a_failed_one_are_shown(project: Path) -> None:
    result = run("test", "notes", "-k", "can_be_read", "--lines")
    assert "│ notes.write │ 1 " in result.output
    assert "20-24" in result.output
    assert "      0       0    23      state.delete(" in result.output
    assert "      1 " in result.output
    path = project / "test_notes.py"
    path.write_text(path.read_text(encoding="utf-8").replace('caller="bob")', 'caller="alice")'), encoding="utf-8")
    document = outcome_of("notes")
    assert (document["ok"], document["exit_code"]) == (False, 1)
    assert "notes.erase came to OK instead of NOT_AUTHOR." in document["output"]
    assert 'require(note["author"] == ctx.caller' in document["output"]


def test_nothing_is_written_over(project: Path) -> None:
    (project / "notes.py").write_text("mine", encoding="utf-8")
    again = run("new", "notes")
    assert (again.exit_code, "FILE_EXISTS" in again.stderr) == (1, True)
    assert (project / "notes.py").read_text(encoding="utf-8") == "mine"
    assert json.loads(run("new", "other", "--dir", "elsewhere", "--json").stdout)["folder"] == "elsewhere"


def test_a_name_is_one_that_a_chain_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.chdir(tmp_path)
    for wrong in ("Notes", "1st", "a/b", "x" * 40):
        assert "CONTRACT_SOURCE_INVALID" in run("new", wrong).stderr
    assert list(tmp_path.iterdir()) == []
    assert run("new", "lost-notes").exit_code == 0
    assert outcome_of("lost-notes")["ok"]


def test_mypy_knows_the_language(project: Path) -> None:
    """A contract is clean as it is written; a wrong name or type in it is found."""

    def mypy() -> str:
        command = [sys.executable, "-m", "mypy", "--no-incremental", "--no-error-summary", "notes.py"]
        return subprocess.run(command, cwd=project, check=False, capture_output=True, text=True).stdout

    assert mypy() == ""
    path = project / "notes.py"
    source = path.read_text(encoding="utf-8")
    path.write_text(source.replace("u64(number), {", "u46(number), {").replace('(b"last", number', '("last", number'))
    found = mypy()
    assert 'Name "u46" is not defined' in found
    assert 'has incompatible type "str"; expected "bytes"' in found


def test_mypy_knows_the_examples(tmp_path: Path) -> None:
    typings = Path(template.__file__).parent / "typings"
    settings = f"[mypy]\nplugins = contracts.kit.mypy_plugin\nmypy_path = {typings}\nstrict = true\n"
    settings += "allow_untyped_defs = true\nallow_untyped_calls = true\nallow_incomplete_defs = true\n"
    settings += "allow_any_generics = true\nwarn_return_any = false\nallow_untyped_decorators = true\n"
    (tmp_path / "mypy.ini").write_text(settings, encoding="utf-8")
    sources = [str(path) for path in sorted(EXAMPLES.glob("*/*.py")) if not path.name.startswith("test_")]
    assert len(sources) == 3
    command = [sys.executable, "-m", "mypy", "--no-incremental", "--config-file", "mypy.ini", *sources]
    done = subprocess.run(command, cwd=tmp_path, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "Success: no issues found in 3 source files\n"), done.stderr


def test_a_contract_may_be_called_as_a_test_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.chdir(tmp_path)
    for name in ("blood_test", "test_of_blood"):
        assert run("new", name).exit_code == 0
        document = outcome_of(name)
        assert document["ok"], document["output"]


def test_a_contract_is_not_taken_for_its_test(project: Path) -> None:
    result = run("test", "notes/notes.py")
    assert (result.exit_code, "name its test" in result.stderr) == (2, True)


def test_versions_of_a_contract_are_told_apart(project: Path) -> None:
    source = (project / "notes.py").read_text(encoding="utf-8")
    (project / "notes_1.py").write_text(source + "\n# The first one.\n", encoding="utf-8")
    (project / "test_versions.py").write_text(
        "def test_both(chain):\n"
        "    notes = chain.deploy('notes_1.py', 'notes')\n"
        "    notes.call('write', 'Milk')\n"
        "    chain.deploy('notes.py').call('write', 'Bread')\n",
        encoding="utf-8",
    )
    shown = run("test", "notes/test_versions.py").output
    rows = [line for line in shown.splitlines() if "notes.write" in line]
    assert ["notes/notes.py" in row for row in rows] == [True, False]
    assert ["notes/notes_1.py" in row for row in rows] == [False, True]


def test_the_stub_names_all_of_the_language_and_the_examples_leave_no_line_out() -> None:
    stub = read_dialect_stub()
    builtin = set(dir(__builtins__)) if not isinstance(__builtins__, dict) else set(__builtins__)
    names = RESERVED - builtin - {"charge_source", "check_source"}
    assert [name for name in sorted(names) if f"def {name}(" not in stub and f"\n{name}: " not in stub] == []
    document = outcome_of(str(EXAMPLES))
    assert document["ok"], document["output"]
    names = {source["contract"]: source["missing"] for source in document["sources"]}
    assert names == {"visitor_log": [], "medication": [], "lost_property": []}
    assert ranges([1, 2, 3, 5, 7, 8]) == "1-3, 5, 7-8"
    assert ranges([]) == ""
