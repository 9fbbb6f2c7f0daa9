"""`blockrobot contract new | test`: creates a contract; tests it with pytest and gas report."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import click
import msgspec

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FOLDER, command_output, console, print_answer
from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from consensus.visible_text import split_lines
from contracts.kit.sources import is_contract_file, read_source
from contracts.kit.template import project_files, write_project
from contracts.vm import compile_contract
from network.cli.contract.contract_answers import ContractNewAnswer, ContractTestAnswer, TestedSource
from network.cli.governance.governance_signer import plain_table

PLUGIN = "contracts.kit.plugin"
# What a plugin for other tests says where a project has no settings for it.
_NOISE = 'ignore:The configuration option "asyncio_default_fixture_loop_scope" is unset'


@click.command()
@click.argument("name")
@click.option("--dir", "folder", type=FOLDER, help="Where to write it (default: ./NAME).")
@command_output
def new(name: str, folder: Path | None, as_json: bool) -> None:
    """Begin a contract: a source that works, its test, and what editors and mypy need to know the language.

    Example: blockrobot contract new visitor_log
    """
    compile_contract(project_files(name)[f"{name}.py"], name)
    place = folder or Path(name)
    written = write_project(place, name)
    if as_json:
        print_answer(ContractNewAnswer(folder=str(place), files=[str(path) for path in written]))
        return
    for path in written:
        console.print(escape(str(path)))
    console.print(escape(f"Next step: blockrobot contract test {shlex.quote(str(place))}"))


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("path", type=click.Path(path_type=Path, exists=True), default=Path())
@click.option("--lines", is_flag=True, help="Show every source with the runs and the gas of each line.")
@click.option("-k", "chosen", metavar="WORDS", help="Only tests whose names match, as pytest reads it.")
@command_output
def test(path: Path, lines: bool, chosen: str | None, as_json: bool) -> None:
    """Run the tests of contracts with pytest; show the gas of each entry and what no test has run.

    Tests take the fixture `chain`: the real interpreter, without nodes. Exit code 1 if a test fails.

    Example: blockrobot contract test visitor_log --lines
    """
    if path.is_file() and is_contract_file(path):
        raise click.UsageError(f"{path} is a contract: name its test, or the folder of both.")
    if importlib.util.find_spec("pytest") is None:
        raise BlockRobotError("CONTRACT_KIT_INCOMPLETE", "pytest is not installed.")
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch) / "report.json"
        code, output = _run_pytest(path, chosen, place, quiet=as_json)
        sources: list[TestedSource] = []
        if place.exists():
            report = read_json_text(place.read_text(encoding="utf-8"))
            sources = msgspec.convert(report["sources"], list[TestedSource])
    if as_json:
        print_answer(ContractTestAnswer(exit_code=code, output=output, sources=sources), ok=code == 0)
    else:
        _print_gas(sources)
        _print_coverage(sources)
        if lines:
            for source in sources:
                _print_lines(source)
    if code:
        sys.exit(1)


def _run_pytest(path: Path, chosen: str | None, report: Path, *, quiet: bool) -> tuple[int, str]:
    command = [sys.executable, "-W", _NOISE, "-m", "pytest", str(path), "--contract-report", str(report), "-q"]
    # Named as pytest names it, for it would not take the same plugin a second time under another name.
    command += ["-p", "blockrobot" if importlib.metadata.entry_points(group="pytest11", name="blockrobot") else PLUGIN]
    if chosen is not None:
        command += ["-k", chosen]
    sys.stdout.flush()
    done = subprocess.run(command, check=False, text=True, stdout=subprocess.PIPE if quiet else None)
    return done.returncode, done.stdout or ""


def _print_gas(sources: list[TestedSource]) -> None:
    rows = [(source, entry) for source in sources for entry in source.entries]
    if not rows:
        return
    columns = ["entry", "calls", "least", "median", "most"]
    names = [source.contract for source in sources]
    has_versions = len(set(names)) < len(names)
    table = plain_table("Gas of the calls that succeeded", [*columns, "source"] if has_versions else columns)
    for source, entry in rows:
        figures = [str(figure) for figure in (entry.calls, entry.gas_min, entry.gas_median, entry.gas_max)]
        place = [_shown_file(source)] if has_versions else []
        table.add_row(f"{source.contract}.{entry.name}", *figures, *place)
    console.print(table)


def _print_coverage(sources: list[TestedSource]) -> None:
    if not sources:
        return
    table = plain_table("Lines that tests ran", ["source", "lines", "ran", "share", "not run"])
    for source in sources:
        count, covered = source.lines_count, source.covered
        share = f"{100 * covered // count}%" if count else ""
        table.add_row(_shown_file(source), str(count), str(covered), share, ranges(source.missing))
    console.print(table)


def _shown_file(source: TestedSource) -> str:
    if not source.file:
        return source.contract
    path = Path(source.file)
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def ranges(numbers: list[int]) -> str:
    parts: list[list[int]] = []
    for number in numbers:
        if parts and parts[-1][1] == number - 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in parts)


def _print_lines(source: TestedSource) -> None:
    if not source.file:
        return
    console.print(escape(f"\n{_shown_file(source)}\n   runs      gas"))
    figures = {line.line: line for line in source.lines}
    for number, text in enumerate(split_lines(read_source(Path(source.file))), 1):
        found = figures.get(number)
        before = " " * 15 if found is None else f"{found.runs:>7} {found.gas:>7}"
        console.print(escape(f"{before}  {number:>4}  {text}"))
