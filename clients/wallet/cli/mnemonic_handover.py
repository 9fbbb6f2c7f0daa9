"""Hands a mnemonic to its owner by file or terminal, with checks."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from clients.sdk.new_files import read_given_text
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import ask_for, ask_for_enter, clear_screen, console
from clients.wallet.presentation.translations import WrongUsage, text
from consensus.errors import BlockRobotError

CHECKED_COUNT = 3
CHECK_TRIES_MAX_COUNT = 5
_COLUMN_CHARACTERS = 14


def write_words(path: Path, words: str) -> None:
    """Write a mnemonic to an owner-only new file, or accept an identical one. Raises UsageError."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if read_given_text(path).strip() == words:
            return
        raise WrongUsage("file_there", path=path) from None
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(words + "\n")
        file.flush()
        os.fsync(file.fileno())


def word_lines(words: str, width: int) -> list[str]:
    columns = 4 if width >= 4 * _COLUMN_CHARACTERS else 2 if width >= 2 * _COLUMN_CHARACTERS else 1
    instructions = [f"{number:>2} {word:<9}" for number, word in enumerate(words.split(), 1)]
    return ["  ".join(instructions[start : start + columns]).rstrip() for start in range(0, len(instructions), columns)]


def print_words(instructions: str, words: str) -> None:
    console.print(escape(instructions) + "\n")
    for line in word_lines(words, console.width):
        console.print(line, style="bold")


@contextlib.contextmanager
def _wiped_afterwards() -> Iterator[None]:
    try:
        yield
    finally:
        clear_screen()


def show_and_wipe(instructions: str, words: str) -> None:
    """Show a mnemonic on an empty screen, then wipe it. Raises Abort on Ctrl-C."""
    clear_screen()
    with _wiped_afterwards():
        print_words(instructions, words)
        ask_for_enter(text("new.written"))


def confirm_words(words: str, count: int, *, texts_of: str, show_again: Callable[[], None]) -> None:
    """Ask for randomly chosen words until all are right; then wipe the input. `texts_of` is the catalogue key.

    Raises WORDS_NOT_CHECKED after `count` wrong ones, Abort on Ctrl-C.
    """
    with _wiped_afterwards():
        is_right = _ask_back(words, count, texts_of, show_again)
    if not is_right:
        console.print(text(f"{texts_of}.check_failed"))
        raise BlockRobotError("WORDS_NOT_CHECKED")


def _ask_back(words: str, count: int, texts_of: str, show_again: Callable[[], None]) -> bool:
    console.print("\n" + text(f"{texts_of}.check"))
    wanted = sorted(secrets.SystemRandom().sample(range(len(words.split())), count))
    left = CHECK_TRIES_MAX_COUNT
    for place in wanted:
        question = text("new.check_word", number=place + 1)
        while (answer := ask_for(question).strip().lower()) != words.split()[place]:
            if answer == "?":
                show_again()
                continue
            left -= 1
            if not left:
                return False
            console.print(text("new.check_wrong", number=place + 1, count=left))
    return True


def show_and_check(instructions: str, words: str, count: int = CHECKED_COUNT, *, texts_of: str = "new") -> None:
    show = partial(show_and_wipe, instructions, words)
    show()
    confirm_words(words, count, texts_of=texts_of, show_again=show)
