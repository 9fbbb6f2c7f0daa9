"""`python -m tests.figures`: how large the code is, and what its commands cost to start, as one JSON object."""

from __future__ import annotations

import ast
import json
import re
import resource
import subprocess
import sys
from collections import Counter
from pathlib import Path

import grimp

from tests.architecture.test_state_keys import files_with_raw_keys
from tests.architecture.test_tidy import PACKAGES, ROOT, files_of_tests, modules, place, tree_of

RUNS = 5
LOADED = "import sys; from click.testing import CliRunner; from network.cli.main import main; \
CliRunner().invoke(main, sys.argv[1:]); print('\\n'.join(sys.modules))"


def lines_of(paths: list[Path]) -> int:
    return sum(path.read_text(encoding="utf-8").count("\n") for path in paths)


def docstring_words(paths: tuple[Path, ...]) -> int:
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    found = (ast.get_docstring(node) for path in paths for node in ast.walk(tree_of(path)) if isinstance(node, kinds))
    return sum(len(text.split()) for text in found if text)


def modules_in_circles() -> int:
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    below = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    while leaves := {module for module, imported in below.items() if not imported & below.keys()}:
        below = {module: imported for module, imported in below.items() if module not in leaves}
    return len(below)


def start_cpu_s(*words: str) -> float:
    """Return the least CPU time of some starts of a command: what else runs here only adds to it."""
    spent = []
    for _ in range(RUNS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "network.cli.main", *words], cwd=ROOT, capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return round(min(spent), 2)


def loaded_modules(*words: str) -> int:
    done = subprocess.run([sys.executable, "-c", LOADED, *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return sum(name.split(".")[0] in PACKAGES for name in done.stdout.split())


def figures() -> dict[str, object]:
    product = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    folders = Counter(place(path.parent) for path in modules() if path.name != "__init__.py")
    return {
        "product_modules": len(product),
        "product_lines": lines_of(product),
        "lab_lines": lines_of([path for path in product if "lab" in path.relative_to(ROOT).parts]),
        "test_lines": lines_of(list(files_of_tests())),
        "docstring_words": docstring_words(modules()),
        "files_with_raw_state_keys": len(files_with_raw_keys()),
        "largest_folder": max(folders.items(), key=lambda item: item[1]),
        "modules_in_import_circles": modules_in_circles(),
        "dict_str_any": sum(len(re.findall(r"dict\[str, Any\]", path.read_text(encoding="utf-8"))) for path in product),
        "wallet_help_modules": loaded_modules("wallet", "--help"),
        "wallet_help_cpu_s": start_cpu_s("wallet", "--help"),
        "help_cpu_s": start_cpu_s("--help"),
    }


if __name__ == "__main__":
    json.dump(figures(), sys.stdout, indent=2)
    sys.stdout.write("\n")
