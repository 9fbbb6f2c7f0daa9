"""Sources of contracts as files: read as they are, and told from tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from contracts.kit import Chain
from contracts.kit.sources import is_contract_file, read_source
from contracts.vm.model.faults import ContractSourceError

SOURCE = "@export\ndef f():\n    pass\n"


def test_a_source_is_read_as_a_node_would_get_it(tmp_path: Path) -> None:
    path = tmp_path / "f.py"
    path.write_bytes(SOURCE.replace("\n", "\r\n").encode())
    assert "\r\n" in read_source(path)
    with pytest.raises(ContractSourceError, match="LINE_END"):
        Chain(folder=tmp_path).deploy("f.py")


def test_what_is_no_text_or_no_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "photo.py"
    path.write_bytes(b"\x89PNG\xff")
    with pytest.raises(BlockRobotError, match=r"photo\.py is not a text file"):
        read_source(path)
    assert not is_contract_file(tmp_path)


@pytest.mark.parametrize(
    ("text", "is_contract"),
    [
        (SOURCE, True),
        ("@view\ndef f() -> int:\n    return 1\n", True),
        ("import pytest\n\n" + SOURCE, False),
        ("def test_f(chain):\n    pass\n", False),
        ("@pytest.fixture\ndef f():\n    pass\n", False),
        ("@export\ndef f(:\n", False),
        ("@export\n\x00", False),
        ("", False),
    ],
)
def test_a_contract_marks_entries_and_imports_nothing(tmp_path: Path, text: str, is_contract: bool) -> None:
    path = tmp_path / "it.py"
    path.write_text(text, encoding="utf-8")
    assert is_contract_file(path) is is_contract
