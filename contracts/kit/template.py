"""Template of `blockrobot contract new`: a contract, its test, editor files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from consensus.errors import BlockRobotError

_CONTRACT = '''"""Notes that anybody may leave, and only their author may take away."""

TEXT_MAX_CHARS = 200


@export
def write(text: str) -> int:
    """Leave a note; return its number."""
    require(0 < len(text) <= TEXT_MAX_CHARS, "TEXT_WRONG", "A note has 1 to 200 characters.")
    number = state.get(b"last", 0) + 1
    state.put(b"last", number)
    state.put(b"note/" + u64(number), {"author": ctx.caller, "text": text, "time": ctx.time})
    emit("written", {"number": number})
    return number


@export
def erase(number: int):
    """Take away a note of one's own."""
    note = state.get(b"note/" + u64(number))
    require(note is not None, "NOTE_UNKNOWN", "There is no such note.")
    require(note["author"] == ctx.caller, "NOT_AUTHOR", "Only its author takes a note away.")
    state.delete(b"note/" + u64(number))
    emit("erased", {"number": number})


@view
def read(number: int) -> dict | None:
    """Return a note, or None."""
    return state.get(b"note/" + u64(number))
'''

_TEST = '''"""{title}: what is promised, as tests on a chain of their own."""

from __future__ import annotations

import pytest

from contracts.kit import Chain, Contract


@pytest.fixture
def notes(chain: Chain) -> Contract:
    return chain.deploy("{name}.py")


def test_a_note_can_be_read(chain: Chain, notes: Contract) -> None:
    assert notes.call("write", "Milk, bread", caller="alice") == 1
    assert notes.view("read", 1)["text"] == "Milk, bread"
    assert notes.view("read", 1)["author"] == chain.caller("alice").key
    assert notes.events("written") == [{{"number": 1}}]


def test_only_its_author_takes_a_note_away(notes: Contract) -> None:
    notes.call("write", "Milk, bread", caller="alice")
    notes.expect_failure("NOT_AUTHOR", "erase", 1, caller="bob")
    notes.call("erase", 1, caller="alice")
    assert notes.view("read", 1) is None
    notes.expect_failure("NOTE_UNKNOWN", "erase", 1, caller="alice")


@pytest.mark.parametrize("text", ["", "x" * 201])
def test_a_note_has_a_length(notes: Contract, text: str) -> None:
    notes.expect_failure("TEXT_WRONG", "write", text)
'''

_PROJECT = """# For editors and type checkers: the names of the contract language are described in typings/.
[tool.mypy]
plugins = ["contracts.kit.mypy_plugin"]
mypy_path = "typings"

[[tool.mypy.overrides]]
module = "contracts.*"
ignore_missing_imports = true

[tool.pyright]
stubPath = "typings"

[tool.pytest.ini_options]
testpaths = ["."]
"""

_BUILTINS = """# Editors with Pyright take these names for built in: a contract imports nothing.
from contract_dialect import *
"""

DIALECT_STUB = "contract_dialect.pyi"


def read_dialect_stub() -> str:
    return resources.files("contracts").joinpath("kit", "typings", DIALECT_STUB).read_text(encoding="utf-8")


def project_files(name: str) -> dict[str, str]:
    title = name.replace("_", " ").replace("-", " ").capitalize()
    return {
        f"{name}.py": _CONTRACT,
        f"test_{name.replace('-', '_')}.py": _TEST.format(name=name, title=title),
        "pyproject.toml": _PROJECT,
        f"typings/{DIALECT_STUB}": read_dialect_stub(),
        "typings/__builtins__.pyi": _BUILTINS,
    }


def write_project(folder: Path, name: str) -> list[Path]:
    """Raises FILE_EXISTS before writing anything."""
    files = {folder / place: text for place, text in project_files(name).items()}
    for path in files:
        if path.exists():
            raise BlockRobotError("FILE_EXISTS", f"{path} is there already; nothing was written.")
    for path, text in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    return list(files)
