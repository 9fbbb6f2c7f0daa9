"""Words of a wallet handed to its owner: into a new file, or at a terminal, where they are asked back."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from rich.markup import escape

from clients.sdk.terminal.terminal import ask_for, ask_for_enter, clear_screen, console
from clients.wallet.present.translations import WrongUsage, text
from consensus.errors import BlockRobotError

CHECKED_COUNT = 3
CHECK_TRIES_MAX_COUNT = 5
_COLUMN_CHARACTERS = 14


def write_words(path: Path, words: str) -> None:
    """Write words to a new file that only its owner reads; one that holds them already will do. Raises UsageError."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if path.read_text(encoding="utf-8").strip() == words:
            return
        raise WrongUsage("file_there", path=path) from None
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(words + "\n")
        file.flush()
        os.fsync(file.fileno())


def word_lines(words: str, width: int) -> list[str]:
    """Return the words with their numbers, in as many columns as a terminal of that width has room for."""
    columns = 4 if width >= 4 * _COLUMN_CHARACTERS else 2 if width >= 2 * _COLUMN_CHARACTERS else 1
    told = [f"{number:>2} {word:<9}" for number, word in enumerate(words.split(), 1)]
    return ["  ".join(told[start : start + columns]).rstrip() for start in range(0, len(told), columns)]


def print_words(told: str, words: str) -> None:
    """Print words below what is told of them, and leave them there."""
    console.print(escape(told) + "\n")
    for line in word_lines(words, console.width):
        console.print(line, style="bold")


@contextlib.contextmanager
def _wiped_afterwards() -> Iterator[None]:
    try:
        yield
    finally:
        clear_screen()


def show_alone(told: str, words: str) -> None:
    """Show words on an empty screen until they are written down, and wipe them. Raises Abort at the first Ctrl-C."""
    clear_screen()
    with _wiped_afterwards():
        print_words(told, words)
        ask_for_enter(text("new.written"))


def check_back(words: str, count: int, *, said: str, show_again: Callable[[], None]) -> None:
    """Ask for some of the words, drawn by chance, until each is right or so many were wrong; then wipe what was typed.

    `said` is where the catalogue has what it is about. `show_again` is what a ? does. Raises WORDS_NOT_CHECKED, and
    Abort at the first Ctrl-C.
    """
    with _wiped_afterwards():
        is_right = _ask_back(words, count, said, show_again)
    if not is_right:
        console.print(text(f"{said}.check_failed"))
        raise BlockRobotError("WORDS_NOT_CHECKED")


def _ask_back(words: str, count: int, said: str, show_again: Callable[[], None]) -> bool:
    console.print("\n" + text(f"{said}.check"))
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


def show_and_check(told: str, words: str, count: int = CHECKED_COUNT, *, said: str = "new") -> None:
    """Show words alone, and ask for some of them back. Raises what `check_back` raises."""
    show = partial(show_alone, told, words)
    show()
    check_back(words, count, said=said, show_again=show)
