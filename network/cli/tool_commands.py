"""`blockrobot completion`: shell completion scripts. `blockrobot reference`: the reference pages, made from the code."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from clients.sdk.terminal.terminal import EXIT_FAILED, FOLDER, command_output, console, print_answer
from network.cli.tool_answers import CompletionAnswer, ReferenceAnswer

_PROGRAM, _VARIABLE = "blockrobot", "_BLOCKROBOT_COMPLETE"
_SHELLS = ("bash", "fish", "zsh")


@click.command()
@click.argument("shell", type=click.Choice(_SHELLS))
@command_output
def completion(shell: str, as_json: bool) -> None:
    """Print the completion script of a shell: commands, options, profiles, records that were viewed here.

    To have it for good: bash into ~/.local/share/bash-completion/completions/blockrobot, zsh into ~/.zfunc/_blockrobot,
    fish into ~/.config/fish/completions/blockrobot.fish. Completing asks no network and opens no wallet.

    Example: eval "$(blockrobot completion bash)"
    """
    found = get_completion_class(shell)
    assert found is not None
    script = found(click.Group(_PROGRAM), {}, _PROGRAM, _VARIABLE)
    text = script.source_template % script.source_vars()
    if as_json:
        print_answer(CompletionAnswer(shell=shell, script=text))
    else:
        click.echo(text)


@click.command()
@click.option("--out", type=FOLDER, default=Path("docs/reference"), show_default=True, help="The folder of the pages.")
@click.option("--check", is_flag=True, help="Write nothing; exit 1 if a page is not current.")
@command_output
def reference(out: Path, check: bool, as_json: bool) -> None:
    """Write http-api.md, errors.md, authorisation.md, state.md and json-output.md, made from the tables in the code.

    Example: blockrobot reference --check
    """
    from network.cli.json_reference import PAGE, SCHEMA, write_json_page, write_json_schema  # noqa: PLC0415 - every client's, only when it is needed
    from node.api.openapi.reference_pages import pages  # noqa: PLC0415 - a node's code, only when it is needed

    texts = {**pages(), PAGE: write_json_page(), SCHEMA: write_json_schema()}
    stale = [name for name, text in texts.items() if _read(out / name) != text]
    if not check:
        out.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (out / name).write_text(text, encoding="utf-8")
    if as_json:
        answer = ReferenceAnswer(folder=str(out), changed=stale, written=not check)
        print_answer(answer, ok=not (check and stale))
    elif check:
        console.print(f"Not current: {', '.join(stale)}." if stale else "Every page is current.")
    else:
        console.print(f"Changed: {', '.join(stale)}." if stale else "Nothing changed.")
    if check and stale:
        sys.exit(EXIT_FAILED)


def _read(path: Path) -> str | None:
    return path.read_text(encoding="utf-8") if path.is_file() else None
