"""The mypy plugin of the author's kit: it lets contracts see the names of the language.

A contract imports nothing; whoever has a decorator of the language at the top of a module without imports is taken for
one. mypy then reads it as if `from contract_dialect import *` stood at its beginning.
"""

from __future__ import annotations

from mypy.nodes import Decorator, ImportAll, ImportBase, MypyFile, NameExpr
from mypy.plugin import Plugin

DIALECT = "contract_dialect"
KINDS = frozenset({"export", "view", "genesis", "migrate"})
_PRIORITY = 5


def is_contract(file: MypyFile) -> bool:
    """Tell whether a module is written in the contract language."""
    if any(isinstance(item, ImportBase) for item in file.defs):
        return False
    marks = (mark for item in file.defs if isinstance(item, Decorator) for mark in item.original_decorators)
    return any(isinstance(mark, NameExpr) and mark.name in KINDS for mark in marks)


class ContractPlugin(Plugin):
    """Adds the names of the language to contracts."""

    def get_additional_deps(self, file: MypyFile) -> list[tuple[int, str, int]]:
        """Return what a file needs besides its imports; for contracts put that import into it."""
        if not is_contract(file):
            return []
        names = ImportAll(DIALECT, 0)
        names.line = 1
        file.defs.insert(0, names)
        file.imports.append(names)
        return [(_PRIORITY, DIALECT, 1)]


def plugin(version: str) -> type[Plugin]:  # noqa: ARG001 - mypy's signature
    """Return the plugin, whatever mypy's version is."""
    return ContractPlugin
