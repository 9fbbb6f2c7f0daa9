"""The arrows of the house, as import-linter contracts in pyproject.toml; and what a client's process really loads."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import grimp
import pytest
from importlinter.application import use_cases
from importlinter.configuration import configure

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("consensus", "contracts", "node", "clients", "network", "pages")
DIALECT_FOLDERS = (ROOT / "contracts" / "privacy", ROOT / "contracts" / "system")
NODE_LIBRARIES = ("lmdb", "pymongo", "prometheus_client")


def test_every_arrow_of_the_house_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    configure()
    assert use_cases.lint_imports(config_filename="pyproject.toml", cache_dir=None)


def test_the_linter_sees_every_module() -> None:
    """A folder without `__init__.py` would be left out silently, and could import what it likes."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    modules = set()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            if path.parent in DIALECT_FOLDERS:
                continue
            parts = path.relative_to(ROOT).with_suffix("").parts
            modules.add(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    assert modules - graph.modules == set()


def test_the_client_library_knows_no_terminal_outside_of_its_folder_terminal() -> None:
    graph = grimp.build_graph("clients", include_external_packages=True, cache_dir=None)
    terminal = ("clients.sdk.terminal", "click", "rich")
    core = {name for name in graph.modules if name.startswith("clients.sdk") and not name.startswith(terminal)}
    assert "clients.sdk.network_client" in core
    found = {(name, other) for name in core for other in graph.find_modules_directly_imported_by(name)}
    assert [pair for pair in sorted(found) if pair[1].startswith(terminal)] == []


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Imports for types alone count too: who reads one of the modules has to read all of them."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    below = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    while leaves := {module for module, imported in below.items() if not imported & below.keys()}:
        below = {module: imported for module, imported in below.items() if module not in leaves}
    assert below == {}


@pytest.mark.parametrize(
    ("module", "others"),
    [
        ("clients.wallet.cli.main", ("clients.robot", "clients.registrar")),
        ("clients.robot.cli.main", ("clients.wallet", "clients.registrar")),
        ("clients.registrar.cli", ("clients.wallet", "clients.robot")),
        ("clients.bundle.cli", ("clients.wallet", "clients.robot", "clients.registrar")),
    ],
)
def test_a_clients_process_loads_no_code_of_a_node(module: str, others: tuple[str, ...]) -> None:
    forbidden = ("node", "contracts", *NODE_LIBRARIES, *others)
    program = (
        f"import click, sys, {module} as cli\n"
        "for group in vars(cli).copy().values():\n"
        "    if isinstance(group, click.Group):\n"
        "        [group.get_command(click.Context(group), name) for name in group.list_commands(click.Context(group))]\n"
        "print('\\n'.join(sys.modules))"
    )
    child = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = child.stdout.split()
    assert module in loaded
    assert [
        name for name in loaded if name.startswith(tuple(f"{root}." for root in forbidden)) or name in forbidden
    ] == []


@pytest.mark.parametrize("words", [["--help"], ["wallet", "--help"]])
def test_the_list_of_commands_imports_none_of_them(words: list[str]) -> None:
    program = (
        "import sys\nfrom click.testing import CliRunner\nfrom network.cli.main import main\n"
        f"result = CliRunner().invoke(main, {words})\n"
        "assert result.exit_code == 0, result.output\nprint('\\n'.join(sys.modules))"
    )
    child = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = child.stdout.split()
    assert [name for name in loaded if name.split(".")[0] in {"node", "contracts", *NODE_LIBRARIES}] == []
    assert not {"aiohttp", "cv2", "numpy", "msgspec", "structlog"} & set(loaded)
    assert len([name for name in loaded if name.split(".")[0] in PACKAGES]) <= 40


def test_work_at_home_loads_nothing_of_a_cluster() -> None:
    program = (
        "import sys\nfrom network.sim.sweep import plan_of, sweep\n"
        "assert sweep([plan_of(1, 1, 10, 0)], workers=1).seeds == 1\nprint('\\n'.join(sys.modules))"
    )
    child = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = child.stdout.split()
    assert "network.bench.cluster" in loaded
    assert not {"dask", "distributed", "tornado"} & set(loaded)
