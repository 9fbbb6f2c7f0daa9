"""A question that already waits, in a real pseudo-terminal: the first Ctrl-C ends it, and nothing goes on after it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pexpect
import pytest

_COMMAND = """
import asyncio
import click
from clients.sdk.terminal import ask, ask_for

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
    """Begin a command that asks within the event loop; return it once its question is there and it waits for a key.

    Python hears of a signal between two steps or from a call that it breaks off. One that comes in the moment before the
    reading begins is heard with the next key, here as anywhere: so it is the reading that is waited for.
    """
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    code = _COMMAND.format(question=question)
    child = pexpect.spawn(sys.executable, ["-c", code], encoding="utf-8", env=environment, timeout=60)
    child.expect(r"Well\?.*: ")
    while not is_waiting(child.pid):
        os.sched_yield()
    return child


def is_waiting(pid: int) -> bool:
    """Tell whether a process sleeps until something comes."""
    return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "S"


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
