"""`blockrobot completion`: prints shell completion scripts."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from clients.sdk.terminal.terminal import command_output, print_answer
from network.cli.tool_answers import CompletionAnswer

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
