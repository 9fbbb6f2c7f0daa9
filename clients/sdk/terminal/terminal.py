"""Command output: lines or one JSON object, and errors. Exit codes: `consensus.exit_codes`; 2 is click's wrong usage."""

from __future__ import annotations

import asyncio
import functools
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from rich.text import Text

from clients.sdk.new_files import read_given_file
from clients.sdk.node_hints import HINTS
from clients.sdk.terminal.ascii_output import is_utf8
from clients.sdk.terminal.safe_output import SafeConsole, keep_own_tags, overwrite_line, write_trusted
from clients.sdk.terminal.told_nodes import note_genesis_place, say_once, told_nodes
from consensus import exit_codes
from consensus.errors import BlockRobotError
from consensus.visible_text import escape_controls, one_entry

if TYPE_CHECKING:
    from clients.sdk.terminal.json_answers import Answer
    from consensus.chain.genesis import Genesis

EXIT_FAILED = exit_codes.EXIT_FAILED
JSON_OPTION = "--json"

FILE = click.Path(path_type=Path, dir_okay=False)
EXISTING_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)

F = TypeVar("F", bound=Callable[..., Any])

console = SafeConsole(highlight=False, emoji=False, soft_wrap=True)
error_console = SafeConsole(highlight=False, emoji=False, soft_wrap=True, stderr=True)

_PLAIN_ROWS_COUNT = 100
_SAYING_KEY = "blockrobot.say_error"
_ANSWERS_KEY = "blockrobot.answers"


def home_folder() -> Path:
    """BLOCKROBOT_HOME, else the platform's folder for data."""
    named = os.environ.get("BLOCKROBOT_HOME")
    if named:
        return Path(named)
    from platformdirs import user_data_path  # noqa: PLC0415 - help needs none

    return user_data_path("blockrobot", appauthor=False)


def load_genesis(path: Path) -> Genesis:
    """Raises GENESIS_INVALID, also if missing; FILE_UNUSABLE if too large."""
    from consensus.bounded_text import JSON_MAX_BYTES  # noqa: PLC0415 - help needs no genesis
    from consensus.chain.genesis import genesis_from_json  # noqa: PLC0415

    try:
        genesis = genesis_from_json(read_given_file(path, JSON_MAX_BYTES))
    except FileNotFoundError:
        raise BlockRobotError("GENESIS_INVALID", f"There is no genesis file at {path}.") from None
    note_genesis_place(path, genesis.chain_id)
    return genesis


def json_option(command: F) -> F:
    return click.option(JSON_OPTION, "as_json", is_flag=True, help="Print one JSON object.")(command)


def wants_json(arguments: Sequence[str]) -> bool:
    """Even in an unparsable line."""
    options = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return JSON_OPTION in options


def write_json(value: Any) -> str:
    """Indented; ASCII-only where the output requires it."""
    return json.dumps(value, indent=2, ensure_ascii=not is_utf8(sys.stdout))


def print_json(value: Any) -> None:
    click.echo(write_json(value))


def print_answer(answer: Answer, *, ok: bool = True) -> None:
    """As one JSON object, `ok` first."""
    import msgspec  # noqa: PLC0415 - help needs none

    print_json({"ok": ok, **msgspec.to_builtins(answer, builtin_types=(bytes,))})


def print_line(text: str) -> None:
    """On one line, without markup, whatever names of others stand in it."""
    console.print(escape_controls(text, ""), markup=False)


@contextmanager
def status_line(text: str, *, as_json: bool) -> Iterator[Callable[[str], None]]:
    """Show status on a terminal only; yields a function to update it."""
    if as_json or not console.is_terminal:
        yield lambda _text: None
        return
    with console.status(text, spinner="dots" if is_utf8(sys.stdout) else "line") as status:
        yield lambda now: status.update(Text.from_markup(keep_own_tags(now)))


@contextmanager
def _stopped_by_interrupt() -> Iterator[None]:
    """Raise Abort at the first Ctrl-C, which asyncio.run only turns into cancellation."""
    try:
        running = asyncio.current_task()
    except RuntimeError:
        running = None
    before = signal.getsignal(signal.SIGINT)
    ours = callable(before) and threading.current_thread() is threading.main_thread()
    try:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if running is not None and running.cancelling():
            raise click.Abort  # Ctrl-C came while the text before the question was written
        yield
    except KeyboardInterrupt:
        raise click.Abort from None
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)


@dataclass(frozen=True, slots=True)
class Answers:
    """Localised yes and no; `declined` is printed after a no."""

    yes: frozenset[str]
    no: frozenset[str]
    hint: str
    again: str
    declined: str


class Declined(click.Abort):
    """The user answered no; `str` is the message to print."""


def set_confirm_words(context: click.Context, answers: Answers) -> None:
    context.meta[_ANSWERS_KEY] = answers


def ask(question: str, *, err: bool = False) -> None:
    """Also inside the event loop. Raises Abort."""
    context = click.get_current_context(silent=True)
    answers = None if context is None else context.meta.get(_ANSWERS_KEY)
    with _stopped_by_interrupt():
        if answers is None:
            click.confirm(question, abort=True, err=err)
        elif not _is_yes(question, answers, err=err):
            raise Declined(answers.declined)


def _is_yes(question: str, answers: Answers, *, err: bool) -> bool:
    while True:
        reply = click.prompt(f"{question} {answers.hint}", default="", show_default=False, err=err).strip().casefold()
        if reply in answers.yes:
            return True
        if not reply or reply in answers.no:
            return False
        click.echo(answers.again, err=err)


def ask_for(text: str) -> str:
    """Also inside the event loop. Raises Abort."""
    with _stopped_by_interrupt():
        return str(click.prompt(text))


def ask_for_enter(text: str) -> None:
    """Raises Abort at Ctrl-C."""
    with _stopped_by_interrupt():
        click.prompt(text, default="", show_default=False)


def can_ask() -> bool:
    return sys.stdin.isatty()


def is_at_terminal() -> bool:
    """Input and output: fit for secrets."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def clear_screen() -> None:
    """Clear screen and scrollback after secrets; print empty lines where that is impossible."""
    if not console.is_terminal:
        return
    wiped = "\n" * _PLAIN_ROWS_COUNT if console.is_dumb_terminal else "\x1b[H\x1b[2J\x1b[3J"
    write_trusted(wiped)
    sys.stdout.flush()


def set_error_formatter(context: click.Context, saying: Callable[[BlockRobotError], str]) -> None:
    """For people, not for JSON."""
    context.meta[_SAYING_KEY] = saying


def say_error(error: BlockRobotError) -> str:
    """With code and next step, for people."""
    context = click.get_current_context(silent=True)
    saying = None if context is None else context.meta.get(_SAYING_KEY)
    return saying(error) if saying else f"{one_entry(error.detail)}\n  {error.code}. Next step: {error.next_step}"


HINTS.read, HINTS.tell = told_nodes, lambda refusal: say_once(say_error(refusal))


def problem_json(error: BlockRobotError) -> dict[str, str]:
    return {"code": error.code, "detail": error.detail, "next_step": error.next_step}


def fail(error: BlockRobotError, *, as_json: bool = False) -> int:
    """Print error, code and next step on standard error; return exit code."""
    if as_json:
        click.echo(json.dumps({"ok": False, "error": problem_json(error)}, ensure_ascii=not is_utf8(sys.stdout)))
    else:
        click.echo(say_error(error), err=True)
    return exit_codes.exit_code_of(error.entry)


def handle_errors(command: F) -> F:
    """Into message, code, next step and exit code."""

    @functools.wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        from clients.sdk.terminal.safe_logging import show_log_lines_safely  # noqa: PLC0415 - help needs no logging

        show_log_lines_safely()
        try:
            return command(*args, **kwargs)
        except BlockRobotError as error:
            refusal = error
        except Declined as declined:
            click.echo(str(declined), err=True)
            sys.exit(EXIT_FAILED)
        except BrokenPipeError:
            # Whoever read the output has seen enough; what is left of it must not fail once more at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(EXIT_FAILED)
        except OSError as error:
            place = f"{error.filename}: " if error.filename else ""
            refusal = BlockRobotError("FILE_UNUSABLE", f"{place}{error.strerror or type(error).__name__}.")
        except UnicodeDecodeError:
            refusal = BlockRobotError("FILE_UNUSABLE", "A file that should hold text does not.")
        sys.exit(fail(refusal, as_json=bool(kwargs.get("as_json"))))

    return wrapped  # type: ignore[return-value]


def command_output(command: F) -> F:
    """Add --json, and handle errors."""
    return json_option(handle_errors(command))


def show_progress(*, quiet: bool) -> Callable[[str, int, int], None]:
    """What is done, how much of how much: on a terminal's standard error, four updates a second."""
    is_shown = not quiet and sys.stderr.isatty()
    last = 0.0

    def hear(what: str, done: int, of: int) -> None:
        nonlocal last
        now = time.monotonic()
        if is_shown and done < of and now - last > 0.25:
            last = now
            overwrite_line(f"{what}: {100 * done // of} %")
        elif is_shown and done == of:
            overwrite_line()

    return hear


def pluralize(count: int, one: str, many: str = "") -> str:
    """Say a count with its noun: `2 records`."""
    return f"{count} {one if count == 1 else many or one + 's'}"
