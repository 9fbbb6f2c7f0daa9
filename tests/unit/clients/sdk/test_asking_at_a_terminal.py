"""A question that already waits, in a real pseudo-terminal: the first Ctrl-C ends it, and nothing goes on after it."""

from __future__ import annotations

import os
import sys

import pexpect
import pytest

from tests.waiting_process import wait_for_reading

_COMMAND = """
import asyncio
import click
from clients.sdk.terminal.terminal import ask, ask_for

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
