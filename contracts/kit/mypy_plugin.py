"""The mypy plugin that makes the contract language's names known."""

from __future__ import annotations

from mypy.nodes import Decorator, ImportAll, ImportBase, MypyFile, NameExpr
from mypy.plugin import Plugin

DIALECT = "contract_dialect"
KINDS = frozenset({"export", "view", "genesis", "migrate"})
_PRIORITY = 5


def is_contract(file: MypyFile) -> bool:
    if any(isinstance(item, ImportBase) for item in file.defs):
        return False
    marks = (mark for item in file.defs if isinstance(item, Decorator) for mark in item.original_decorators)
    return any(isinstance(mark, NameExpr) and mark.name in KINDS for mark in marks)


class ContractPlugin(Plugin):
    """Adds the names of the contract language."""

    def get_additional_deps(self, file: MypyFile) -> list[tuple[int, str, int]]:
        if not is_contract(file):
            return []
        names = ImportAll(DIALECT, 0)
        names.line = 1
        file.defs.insert(0, names)
        file.imports.append(names)
        return [(_PRIORITY, DIALECT, 1)]


def plugin(version: str) -> type[Plugin]:  # noqa: ARG001 - mypy's signature
    return ContractPlugin
