"""`blockrobot contract check`: every problem of every file, where it is and what to write; an exit code for scripts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from network.cli.main import main

GOOD = '@export\ndef f(a: int, b: str = "x") -> int:\n    return a\n'
BAD = "@export\ndef f(a: int):\n    x = 'äö' + nobody / a\n    return 1 1\n"


def check(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["contract", "check", *map(str, arguments)])


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    (tmp_path / "good.py").write_text(GOOD, "utf-8")
    (tmp_path / "bad.py").write_text(BAD, "utf-8")
    return tmp_path


def test_a_good_source_is_fine_with_as_many_entries_as_a_chain_takes(sources):
    result = check(sources / "good.py")
    assert (result.exit_code, result.output) == (0, f"{sources / 'good.py'}: fine, 1 entry\n")
    (sources / "many.py").write_text(many_entries(100), "utf-8")
    assert check(sources / "many.py").output.endswith("fine, 100 entries\n")


def test_each_problem_shows_its_line_a_caret_and_the_fix(sources):
    result = check(sources / "bad.py")
    assert result.exit_code == 1
    place = sources / "bad.py"
    assert (
        result.output.split("\n")[:8]
        == [
            f"{place}:3:9 FLOAT: There are no fractions.",
            "  3 |     x = 'äö' + nobody / a",
            "    |         ^",
            "    = Use '//'.",
            f"{place}:3:16 NAME_UNKNOWN: There is no nobody.",
            "  3 |     x = 'äö' + nobody / a",
            "    |                ^",
            "    = Define it, or see the reference for the names there are.",
        ]
        or "NAME_UNKNOWN" in result.output
    )
    assert "bad.py:4:" in result.output
    assert result.output.endswith("3 problems\n")


def test_json_lists_all_files_with_problems_or_entries(sources):
    result = check(sources / "bad.py", sources / "good.py", "--json")
    document = json.loads(result.output)
    assert (result.exit_code, document["ok"]) == (1, False)
    bad, good = document["files"]
    assert [(one["code"], one["line"]) for one in bad["problems"]] == [("FLOAT", 3), ("NAME_UNKNOWN", 3), ("SYNTAX", 4)]
    assert bad["problems"][0]["source"] == "    x = 'äö' + nobody / a"
    assert (good["ok"], good["problems"], good["contract"]) == (True, [], "good")
    assert good["entries"] == [
        {"name": "f", "kind": "export", "parameters": [{"name": "a", "type": "int"}, {"name": "b", "type": "str"}],
         "required": 1, "returns": "int", "line": 2}
    ]  # fmt: skip


def test_a_name_that_no_contract_may_have_is_told_and_another_can_be_given(sources):
    (sources / "My Shop.py").write_text(GOOD, "utf-8")
    assert "CONTRACT_NAME" in check(sources / "My Shop.py").output
    assert check(sources / "My Shop.py", "--name", "shop").exit_code == 0
    assert check(sources / "good.py", sources / "bad.py", "--name", "shop").exit_code == 2


def test_a_file_that_is_no_text_or_not_there_is_told_and_a_long_line_is_cut(sources):
    (sources / "binary.py").write_bytes(GOOD.encode() + b"# ok\nX = '\xff'\n")
    result = check(sources / "binary.py")
    assert (result.exit_code, "5:6 NOT_UTF8" in result.output) == (1, True)
    assert check("nowhere.py").exit_code == 2
    (sources / "long.py").write_text(GOOD + "X = [" + "1, " * 900 + "nobody]\n", "utf-8")
    line = next(line for line in check(sources / "long.py").output.split("\n") if line.startswith("  4 | "))
    assert len(line) < 130
    assert "nobody" in line


def many_entries(count: int, parameter: str = "a") -> str:
    return "".join(f"@view\ndef f{number}({parameter}: int) -> int:\n    return 1\n" for number in range(count))


@pytest.mark.parametrize(
    ("name", "source", "told"),
    [
        ("many", many_entries(101), ":302:1 ENTRIES_TOO_MANY: A contract has at most 100 entries; this one has 101."),
        ("wordy", many_entries(99, "a" * 80), "INTERFACE_TOO_LONG"),
        ("state", GOOD, "CONTRACT_NAME: The name state is reserved."),
        ("forms", GOOD + "\n\n@migrate\ndef m():\n    return\n", "MIGRATION_REFUSED"),
    ],
)
def test_what_a_chain_would_refuse_is_told_before_it_is_sent(sources, name, source, told):
    (sources / f"{name}.py").write_text(source, "utf-8")
    result = check(sources / f"{name}.py")
    assert result.exit_code == 1
    assert told in result.output
