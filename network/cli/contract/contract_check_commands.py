"""`blockrobot contract check | vectors`: source problems and golden vectors; exit code 1 on any failure."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import msgspec
from rich.cells import cell_len

from clients.sdk.terminal.terminal import EXISTING_FILE, FOLDER, command_output, print_answer
from consensus.visible_text import escape_controls
from contracts import vectors as golden
from contracts.execution.chain_refusals import find_refusals
from contracts.kit.sources import read_source_bytes
from contracts.vm import LANGUAGE_VERSION, Diagnostic, Entry, compile_contract, find_problems
from network.cli.contract.contract_answers import (
    CheckedEntry,
    CheckedSource,
    ContractCheckAnswer,
    ContractVectorsAnswer,
    EntryParameter,
    SourceProblem,
    VectorDifference,
    VectorsFile,
)

LINE_SHOWN_MAX_CHARS = 120


def check_file(path: Path, name: str) -> tuple[list[str], tuple[Diagnostic, ...], list[CheckedEntry]]:
    """Lines, problems, and ABI entries if sound. Raises FILE_UNUSABLE if too large, OSError."""
    data = read_source_bytes(path)
    try:
        source = data.decode()
    except UnicodeDecodeError as error:
        before = data[: error.start].decode()
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        problem = Diagnostic("NOT_UTF8", line, column, "A source is UTF-8 text.", "Save the file as UTF-8.")
        return data.decode("utf-8", "replace").split("\n"), (problem,), []
    problems, entries = find_problems(source, name), []
    if not problems:
        compiled = compile_contract(source, name)
        problems = find_refusals(source, compiled)
        entries = [] if problems else [_entry_answer(entry) for entry in compiled.abi.entries]
    return source.split("\n"), problems, entries


def _entry_answer(entry: Entry) -> CheckedEntry:
    return CheckedEntry(
        name=entry.name,
        kind=entry.kind,
        parameters=[EntryParameter(name=name, type=kind) for name, kind in entry.params],
        required=entry.required,
        returns=entry.returns,
        line=entry.line,
    )


def source_lines(lines: list[str], problem: Diagnostic) -> tuple[str, str]:
    text = lines[problem.line - 1] if problem.line <= len(lines) else ""
    column = min(problem.column, len(text) + 1)
    start = max(0, column - LINE_SHOWN_MAX_CHARS + 20)
    shown = escape_controls(text[start:][:LINE_SHOWN_MAX_CHARS], "")
    return shown, " " * cell_len(escape_controls(text[start : column - 1], "")) + "^"


def _print_problem(path: Path, lines: list[str], problem: Diagnostic) -> None:
    shown, caret = source_lines(lines, problem)
    number = str(problem.line)
    click.echo(f"{path}:{problem.line}:{problem.column} {problem.code}: {problem.message}")
    click.echo(f"  {number} | {shown}")
    click.echo(f"  {' ' * len(number)} | {caret}")
    click.echo(f"  {' ' * len(number)} = {problem.fix}")


@click.command()
@click.argument("files", nargs=-1, required=True, type=EXISTING_FILE)
@click.option("--name", help="The contract's name, if it is not the file's (for one file).")
@command_output
def check(files: tuple[Path, ...], name: str | None, as_json: bool) -> None:
    """Say whether sources are in the contract language and such as a chain takes, and all that is wrong with them.

    Each problem comes with a code, its line and column, and what to write instead. The codes are explained in
    docs/reference/contract-language.md. Exit code 0: nothing is wrong; 1: something is.

    \b
    Example: blockrobot contract check visitors.py
    Example: blockrobot contract check contracts/*.py --json
    """
    if name is not None and len(files) > 1:
        raise click.UsageError("--name is for one file.")
    checked: list[CheckedSource] = []
    for path in files:
        contract = path.stem if name is None else name
        lines, problems, entries = check_file(path, contract)
        rows = [
            SourceProblem(
                code=problem.code,
                line=problem.line,
                column=problem.column,
                message=problem.message,
                fix=problem.fix,
                source=lines[problem.line - 1] if problem.line <= len(lines) else "",
            )
            for problem in problems
        ]
        checked.append(
            CheckedSource(file=str(path), contract=contract, ok=not problems, problems=rows, entries=entries)
        )
        if not as_json:
            for problem in problems:
                _print_problem(path, lines, problem)
            click.echo(f"{path}: {_summary(len(problems), len(entries))}")
    good = all(source.ok for source in checked)
    if as_json:
        print_answer(ContractCheckAnswer(language=LANGUAGE_VERSION, files=checked), ok=good)
    sys.exit(0 if good else 1)


def _summary(problems: int, entries: int) -> str:
    if problems:
        return "1 problem" if problems == 1 else f"{problems} problems"
    return "fine, 1 entry" if entries == 1 else f"fine, {entries} entries"


VECTORS_FOLDER = Path(golden.__file__).resolve().parents[1] / "tests" / "vectors" / "contracts"


@click.command()
@click.option(
    "--from", "folder", type=click.Path(path_type=Path, exists=True, file_okay=False), default=VECTORS_FOLDER,
    help="The folder of the vectors (those of the source tree).", show_default=False,
)  # fmt: skip
@click.option(
    "--write", "target", type=FOLDER, help="Write down what happens here, there.",
)  # fmt: skip
@command_output
def vectors(folder: Path, target: Path | None, as_json: bool) -> None:
    """Play the golden vectors: does every call end here as it did everywhere else, to the last unit of gas?

    Each file holds contracts, calls and what they came to: results, codes, lines, gas, writes, events and the root of
    the state. With --write they are written anew, which only an intended change of the language calls for.

    \b
    Example: blockrobot contract vectors
    Example: blockrobot contract vectors --write tests/vectors/contracts --json
    """
    documents = golden.read_vectors(folder)
    if target is not None:
        golden.write_vectors({name: golden.play(document) for name, document in documents.items()}, target)
        documents = golden.read_vectors(target)
    differences = {
        name: msgspec.convert(list(golden.compare(document)), list[VectorDifference])
        for name, document in documents.items()
    }
    total = sum(golden.count(document) for document in documents.values())
    good = not any(differences.values())
    if as_json:
        rows = [
            VectorsFile(file=name, count=golden.count(document), differences=differences[name])
            for name, document in documents.items()
        ]
        answer = ContractVectorsAnswer(language=LANGUAGE_VERSION, count=total, files=rows, written=target is not None)
        print_answer(answer, ok=good)
    else:
        _print_differences(differences)
        ending = "and all are as they should be" if good else "and not all are as they should be"
        click.echo(f"{total} calls and sources in {len(documents)} files, {ending}.")
    sys.exit(0 if good else 1)


def _print_differences(differences: dict[str, list[VectorDifference]]) -> None:
    for name, rows in differences.items():
        for row in rows:
            click.echo(f"{name}: {row.call}\n  expected {row.expected}\n  found    {row.found}")
