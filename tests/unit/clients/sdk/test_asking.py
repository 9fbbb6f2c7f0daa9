"""A question within the event loop is not asked after a Ctrl-C, and the wallet has one place that asks so."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import clients

_COMMAND = """
import asyncio, os, signal
import click
from clients.sdk.terminal.terminal import ask, ask_for

signal.signal(signal.SIGINT, signal.default_int_handler)

@click.command()
def command():
    async def main():
        try:
            {question}
            print("went on")
        finally:
            await asyncio.sleep(0)
            print("closed")
    asyncio.run(main())

command()
"""


def test_an_interrupt_right_before_a_question_leaves_it_unasked() -> None:
    code = _COMMAND.format(question='os.kill(os.getpid(), signal.SIGINT); ask("Well?")')
    done = subprocess.run(
        [sys.executable, "-c", code], input="y\n", capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 1
    assert "Well?" not in done.stdout
    assert "went on" not in done.stdout
    assert "Aborted!" in done.stderr


def test_clients_ask_within_the_loop_only_in_this_way() -> None:
    early = {
        "registrar/cli.py",
        "robot/cli/background_commands.py",
        "robot/cli/robot_choice.py",
        "wallet/cli/wallet_context.py",
        "wallet/commands/account/new_commands.py",
        "wallet/commands/rights_commands.py",
    }  # these ask before the loop begins
    folder = Path(clients.__path__[0])
    texts = {path.relative_to(folder).as_posix(): path.read_text(encoding="utf-8") for path in folder.rglob("*.py")}
    asking = {name for name, text in texts.items() if "click.confirm(" in text or "click.prompt(" in text}
    assert asking == {*early, "sdk/terminal/terminal.py"}
