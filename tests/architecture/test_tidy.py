"""The code base itself, as a test: sizes, names, docstrings, words, limits with units, and a catalogue that is used."""

from __future__ import annotations

import ast
import io
import re
import subprocess
import tokenize
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from consensus.errors import CATALOGUE
from tests.architecture.trees import nodes_of, tree_of

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("consensus", "contracts", "node", "clients", "network", "pages")
DIALECT_FOLDERS = (ROOT / "contracts" / "privacy", ROOT / "contracts" / "system")

MODULE_MAX_LINES = 600
VIRTUAL = re.compile(r"@in_virtual_time|\brun_virtual\(|import .*\bstory\b|(Virtual|Sim)Loop")
FOLDER_MAX_MODULES = 15
FUNCTION_MAX_LINES = 80
BANNED_NAMES = {"utils", "util", "helpers", "helper", "manager", "common", "misc"}
UNITS = ("BYTES", "MS", "COUNT", "GAS", "CHARS", "BITS", "DEPTH")

# Written in halves, so that this file may be searched as well.
UNFINISHED = re.compile(r"\b(?:TO" + r"DO|FIX" + r"ME|XX" + r"X|HA" + r"CK)\b")
STUB = re.compile(r"\bNotImplemented" + r"Error\b")
CANNOT_FAIL = re.compile(
    r"\bassert " + r"True\b|\bassert 1\s*$|pytest\.sk" + r"ip\b|\bmark\.sk" + r"ip|\bx" + r"fail\b"
)
MACHINE_PATH = re.compile(r"(?<![\w.])/(?:wo" + r"rk|ho" + r"me/\w+|ro" + r"ot|Us" + r"ers/\w+)/")
FORBIDDEN_WORDS = re.compile(
    r"\.\./sha"
    + r"red|\bDESIGN"
    + r"(?:\.md| §)|\bSPEC"
    + r"\.md\b|\bissue #?\d|\bsub-?ag"
    + r"ent|\bhelper ag"
    + r"ent"
    r"|\b(?:previous|next|this|another) (?:work )?sess" + r"ion of work\b|\bindex-u" + r"rl\b|\bsess" + r"ion \d+\b",
    re.IGNORECASE,
)


@cache
def modules() -> tuple[Path, ...]:
    """Return every Python file of the six packages that CPython runs (contracts are in a language of their own)."""
    found = (path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    return tuple(sorted(path for path in found if path.parent not in DIALECT_FOLDERS))


@cache
def files_of_tests() -> tuple[Path, ...]:
    return tuple(sorted((ROOT / "tests").rglob("*.py")))


@cache
def texts() -> tuple[Path, ...]:
    """Return every file of the project that is text and that a reader may meet."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    suffixes = {".py", ".md", ".toml", ".txt", ".html", ".css", ".js", ".yaml", ".yml", ".json", ".cfg", ""}
    paths = (ROOT / name for name in listed.split("\0") if name)
    return tuple(path for path in paths if path.suffix in suffixes and path.is_file())


def place(path: Path, line: int | None = None) -> str:
    return str(path.relative_to(ROOT)) + ("" if line is None else f":{line}")


def matches(paths: tuple[Path, ...], pattern: re.Pattern[str]) -> list[str]:
    return [
        f"{place(path, number)}: {line.strip()[:100]}"
        for path in paths
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1)
        if pattern.search(line)
    ]


def test_there_is_something_to_look_at() -> None:
    assert len(modules()) > 100
    assert len(texts()) > len(modules())


def test_no_module_folder_or_name_is_too_large_or_says_nothing() -> None:
    counts = Counter(place(path.parent) for path in modules() if path.name != "__init__.py")
    assert {folder: count for folder, count in counts.items() if count > FOLDER_MAX_MODULES} == {}
    lengths = {
        place(path): len(path.read_text(encoding="utf-8").splitlines()) for path in (*modules(), *files_of_tests())
    }
    assert {name: length for name, length in lengths.items() if length > MODULE_MAX_LINES} == {}
    parts = {
        part.removesuffix(".py") for path in (*modules(), *files_of_tests()) for part in path.relative_to(ROOT).parts
    }
    assert parts & BANNED_NAMES == set()


def test_no_function_is_longer_than_80_lines() -> None:
    long = {}
    for path in modules():
        for item in nodes_of(path):
            if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef) and item.end_lineno is not None:
                length = item.end_lineno - item.lineno + 1
                if length > FUNCTION_MAX_LINES:
                    long[f"{place(path, item.lineno)} {item.name}"] = length
    assert long == {}


def test_every_module_says_what_it_is() -> None:
    without = [place(path) for path in modules() if tree_of(path).body and ast.get_docstring(tree_of(path)) is None]
    assert without == []


def test_every_function_is_typed() -> None:
    untyped = []
    for path in modules():
        for item in nodes_of(path):
            if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
                names = [*item.args.posonlyargs, *item.args.args, *item.args.kwonlyargs]
                bare = [arg.arg for arg in names if arg.annotation is None and arg.arg not in {"self", "cls"}]
                if bare or item.returns is None:
                    untyped.append(f"{place(path, item.lineno)} {item.name} {bare}")
    assert untyped == []


@pytest.mark.parametrize("pattern", [UNFINISHED, STUB], ids=["notes to self", "stubs"])
def test_nothing_is_left_unfinished(pattern: re.Pattern[str]) -> None:
    assert matches((*modules(), *files_of_tests()), pattern) == []


def test_no_test_is_switched_off_and_nothing_mocked_in_production_code() -> None:
    assert matches(files_of_tests(), CANNOT_FAIL) == []
    assert matches(modules(), re.compile(r"unittest|\bmock\b|\bpatch\(")) == []


def functions_of_tests() -> list[tuple[Path, ast.FunctionDef | ast.AsyncFunctionDef]]:
    return [
        (path, item)
        for path in files_of_tests()
        for item in nodes_of(path)
        if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef)
    ]


def asserts(item: ast.AST) -> bool:
    """Tell whether something asserts by itself: `assert`, `pytest.raises`, `pytest.fail`, or an AssertionError."""
    for node in ast.walk(item):
        if isinstance(node, ast.Assert):
            return True
        if isinstance(node, ast.Attribute) and node.attr in {"raises", "fail", "assert_never"}:
            return True
        if isinstance(node, ast.Name) and node.id == "AssertionError":
            return True
    return False


NAMED_BY: dict[type[ast.AST], str] = {ast.Name: "id", ast.Attribute: "attr", ast.arg: "arg"}


def names_used(item: ast.AST) -> set[str]:
    """Return every name that a function calls, takes as a fixture or passes on."""
    return {getattr(node, NAMED_BY[type(node)]) for node in ast.walk(item) if type(node) in NAMED_BY}


def test_no_test_is_without_an_assertion() -> None:
    """A test asserts itself, or uses something that asserts: a function of the tests, or a check that raises."""
    functions = functions_of_tests()
    asserting = {item.name for _, item in functions if asserts(item)}
    uses = [(item.name, names_used(item)) for _, item in functions]
    while True:
        more = {name for name, used in uses if name not in asserting and used & asserting}
        if not more:
            break
        asserting |= more
    raising = re.compile(r"\b(?:check|verify|validate|assert|expect|require|lint)_\w+\(|\b(?:check|validate)\(")
    empty = [
        f"{place(path, item.lineno)} {item.name}"
        for path, item in functions
        if item.name.startswith("test_") and item.name not in asserting and not raising.search(ast.unparse(item))
    ]
    assert empty == []


def test_nothing_speaks_of_one_machine_or_of_how_it_was_made() -> None:
    assert matches(texts(), MACHINE_PATH) == []
    assert matches(texts(), FORBIDDEN_WORDS) == []


def test_every_limit_carries_its_unit() -> None:
    limits = ROOT / "consensus" / "limits.py"
    names = [
        target.id
        for item in tree_of(limits).body
        if isinstance(item, ast.Assign)
        for target in item.targets
        if isinstance(target, ast.Name)
    ]
    assert len(names) > 10
    without = [name for name in names if not any(part in UNITS for part in name.split("_"))]
    assert without == []


@cache
def strings_in_code() -> dict[str, list[str]]:
    """Return every string constant of the six packages (not of the catalogue itself) and where it stands."""
    found: dict[str, list[str]] = {}
    for path in modules():
        if path == ROOT / "consensus" / "errors.py":
            continue
        for item in nodes_of(path):
            if isinstance(item, ast.Constant) and isinstance(item.value, str):
                found.setdefault(item.value, []).append(place(path, item.lineno))
    return found


def test_every_error_that_is_raised_is_in_the_catalogue() -> None:
    unknown = [
        f"{place(path, item.lineno)} {item.args[0].value}"
        for path in modules()
        for item in nodes_of(path)
        if isinstance(item, ast.Call)
        and isinstance(item.func, ast.Name)
        and item.func.id == "BlockRobotError"
        and item.args
        and isinstance(item.args[0], ast.Constant)
        and item.args[0].value not in CATALOGUE
    ]
    assert unknown == []


def test_every_error_of_the_catalogue_is_used_and_a_sentence_with_a_next_step() -> None:
    assert sorted(set(CATALOGUE) - set(strings_in_code())) == []
    for entry in CATALOGUE.values():
        assert entry.meaning.endswith("."), entry.code
        assert entry.next_step.endswith("."), entry.code
        assert 400 <= entry.status < 600, entry.code


def test_no_code_is_commented_out_behind_a_hash() -> None:
    """A comment that parses as a call, an assignment or an import was code once."""
    dead = []
    for path in modules():
        for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
            if token.type != tokenize.COMMENT:
                continue
            text = token.string.lstrip("# ").strip()
            if re.match(r"^(?:import \w+$|from \w[\w.]* import |\w+ = \w+\(.*\)$|return \w+$|print\()", text):
                dead.append(f"{place(path, token.start[0])}: {text}")
    assert dead == []


def test_a_unit_test_that_sleeps_stands_in_virtual_time() -> None:
    """What makes the clock virtual is a decorator, a harness or a call in the same file."""
    sleeping = set()
    for path in (ROOT / "tests" / "unit").rglob("test_*.py"):
        source = path.read_text(encoding="utf-8")
        if "sleep(" not in source or VIRTUAL.search(source):
            continue
        calls = [node for node in nodes_of(path) if isinstance(node, ast.Call) and node.args]
        named = {ast.unparse(call) for call in calls if ast.unparse(call.func) in ("asyncio.sleep", "time.sleep")}
        if any("sleep(0" not in call for call in named):
            sleeping.add(path.relative_to(ROOT).as_posix())
    assert sleeping == set()
