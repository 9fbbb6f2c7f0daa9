"""A question within the event loop: the first Ctrl-C ends it and nothing goes on, also where it was not asked yet."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pexpect
import pytest

import clients
from tests.waiting_process import wait_for_reading

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
_QUESTIONS = ['ask("Well?")', 'ask("Well?", err=True)', 'ask_for("Well?")']


def spawn(question: str) -> pexpect.spawn[str]:
    """Begin a command that asks within the event loop; return it once its question is there and it waits for a key."""
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    code = _COMMAND.format(question=question)
    child = pexpect.spawn(sys.executable, ["-c", code], encoding="utf-8", env=environment, timeout=60)
    child.expect(r"Well\?.*: ")
    wait_for_reading(child.pid)
    return child


@pytest.mark.parametrize("question", _QUESTIONS)
def test_the_first_interrupt_ends_a_question_that_waits(question: str) -> None:
    child = spawn(question)
    child.sendintr()
    child.expect(["Aborted!", "went on"])
    shown = f"{child.before}{child.after}{child.read()}"
    child.close()
    assert (child.exitstatus, child.signalstatus) == (1, None), shown
    assert shown.index("closed") < shown.index("Aborted!")
    assert "went on" not in shown
    assert "Traceback" not in shown


@pytest.mark.parametrize("question", _QUESTIONS)
def test_an_answer_goes_on(question: str) -> None:
    child = spawn(question)
    child.sendline("y")
    child.expect("went on")
    child.expect(pexpect.EOF)
    child.close()
    assert child.exitstatus == 0


def test_a_no_ends_it_without_a_traceback() -> None:
    child = spawn(_QUESTIONS[0])
    child.sendline("n")
    child.expect("Aborted!")
    shown = f"{child.before}{child.after}{child.read()}"
    child.close()
    assert child.exitstatus == 1
    assert "went on" not in shown
    assert "Traceback" not in shown


def test_an_interrupt_right_before_a_question_leaves_it_unasked() -> None:
    code = _COMMAND.format(question='os.kill(os.getpid(), signal.SIGINT); ask("Well?")')
    done = subprocess.run(
        [sys.executable, "-c", code], input="y\n", capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, "Aborted!" in done.stderr) == (1, True)
    assert not [said for said in ("Well?", "went on") if said in done.stdout]


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
