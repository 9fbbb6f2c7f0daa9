"""Text of others on a terminal: whatever it holds, only our own colours and pictures move anything."""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Callable
from typing import Any

import click
import pytest
import structlog
from click.testing import CliRunner
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rich.console import Group
from rich.live import Live
from rich.markup import escape as rich_escape
from rich.panel import Panel
from rich.status import Status
from rich.syntax import Syntax
from rich.table import Table
from rich.text import Text

from clients.sdk.terminal import terminal
from clients.sdk.terminal.safe_logging import escape_values
from clients.sdk.terminal.safe_output import (
    SafeConsole,
    SafeStream,
    escape,
    keep_own_tags,
    overwrite_line,
    safe_streams,
)
from consensus.errors import BlockRobotError
from consensus.visible_text import escape_controls, is_control
from network.cli.root_group import RootGroup

SGR = re.compile(r"\x1b\[[0-9;]*m")
OUR_CONTROLS = re.compile(r"\x1b\[(?:[0-9;]*m|\?25[lh]|1A|2K)|\r")
ANY_TEXT = st.text(st.characters(exclude_categories=()), max_size=40)
MARKUP_PIECES = [*"[]/\\ax", "[red]", "[/red]", "[/]", "[link=http://x]", "[bold]", "[/nothing]"]
MARKUP = st.lists(st.sampled_from(MARKUP_PIECES), max_size=8).map("".join)
HOSTILE = "a\x1b[2J\x1b]0;owned\x07\x9b31m\u202eevil\u2066\u2028\x7f\r\x08\ud800[link=http://x][blink]:smile:"


def controls_in(text: str) -> set[str]:
    return {character for character in text if is_control(character)} - {"\n", "\t"}


def on_a_terminal(show: Callable[[SafeConsole], None]) -> str:
    written = io.StringIO()
    show(
        SafeConsole(
            file=written, force_terminal=True, color_system="truecolor", width=300, emoji=False, highlight=False
        )
    )
    return written.getvalue()


def table(text: str) -> Table:
    made = Table(text, title=text, caption=text)
    made.add_row(text)
    made.add_row(Text(text, style="red"))
    return made


WAYS: dict[str, Callable[[SafeConsole, str], None]] = {
    "print": lambda console, text: console.print(text),
    "print without markup": lambda console, text: console.print(text, markup=False),
    "print with style": lambda console, text: console.print(text, style="bold red"),
    "escaped": lambda console, text: console.print(f"[red]{escape(text)}[/red]"),
    "not escaped": lambda console, text: console.print(f"[red]{text}[/red]"),
    "text": lambda console, text: console.print(Text(text)),
    "table": lambda console, text: console.print(table(text)),
    "panel": lambda console, text: console.print(Panel(text, title="x")),
    "group": lambda console, text: console.print(Group(text, Text(text))),
    "syntax": lambda console, text: console.print(Syntax(text, "diff", word_wrap=True)),
    "rule": lambda console, text: console.rule(Text(text)),
}


@pytest.mark.parametrize("way", WAYS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=ANY_TEXT | MARKUP)
@example(HOSTILE)
@example("[/red]")
@example("[red")
@example("\\[red]\\\\[red]\\")
def test_no_control_reaches_a_terminal_whatever_way_a_text_takes(way, text):
    written = on_a_terminal(lambda console: WAYS[way](console, text))
    assert controls_in(SGR.sub("", written)) == set()


@given(ANY_TEXT | MARKUP)
@example(HOSTILE)
def test_no_control_comes_from_what_is_live(text):
    def show(console: SafeConsole) -> None:
        with Live(Text(text), console=console, auto_refresh=False) as live:
            live.update(Group(Text(text), table(text)), refresh=True)
        with Status(Text(text), console=console):
            console.print(text)

    assert controls_in(OUR_CONTROLS.sub("", on_a_terminal(show))) == set()


@given(ANY_TEXT)
@example(HOSTILE)
def test_an_escaped_text_is_shown_as_it_is_but_for_its_controls(text):
    text += "."  # rich doubles a backslash at the very end, for the tag that may follow
    written = on_a_terminal(lambda console: console.print(escape(text), end="", soft_wrap=True))
    assert SGR.sub("", written) == escape_controls(text, "\n\t").expandtabs(8) or "\t" in text


@given(ANY_TEXT | MARKUP)
def test_no_text_colours_or_links_itself_but_by_the_tags_of_ours(text):
    for tag in ("link=http://x", "blink", "conceal", "on black", "black", "reverse", "@click=x"):
        hostile = text.replace("[", "(") + f"[{tag}]x[/{tag}]"
        written = on_a_terminal(lambda console, hostile=hostile: console.print(hostile, end="", soft_wrap=True))
        assert f"[{tag}]x[/{tag}]" in written
        assert "\x1b" not in written


def test_our_own_tags_have_their_meaning():
    written = on_a_terminal(lambda console: console.print("[red]a[/red] [bold]b[/bold] \\[red]c"))
    assert written == "\x1b[31ma\x1b[0m \x1b[1mb\x1b[0m [red]c\n"
    assert keep_own_tags("[red]a[/red]") == "[red]a[/red]"


@given(text=MARKUP)
@example(text="\\\\[a]\\")
def test_text_is_escaped_as_rich_does(text):
    assert escape(text) == rich_escape(text)


def test_a_line_of_backslashes_is_shown_by_their_number_since_markup_of_it_takes_quadratic_time():
    run = "\\" * 60_000
    assert escape(f"a{run}b") == "a(60000 backslashes)b"
    assert SafeConsole(file=io.StringIO()).render_str(f"a{run}b").plain == "a(60000 backslashes)b"


@given(ANY_TEXT)
@example(HOSTILE)
def test_a_stream_takes_any_text_and_writes_no_control(text):
    below = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="")
    stream = SafeStream(below)
    assert stream.write(text) == len(text)
    stream.writelines([text])
    below.seek(0)
    assert controls_in(below.read()) == set()
    assert stream.encoding == "utf-8"
    with pytest.raises(TypeError):
        stream.write(b"x")


def commands(text: str) -> RootGroup:
    """A root with a command for each way in which a command may speak."""
    root = RootGroup("root", places={}, sections={})

    def command(name: str, body: Callable[[], Any]) -> None:
        root.add_command(click.Command(name, callback=body, params=[click.Option(["--json", "as_json"], is_flag=True)]))

    def refused(**_: bool) -> None:
        raise BlockRobotError("INTERNAL", text)

    def wrong(**_: bool) -> None:
        raise click.UsageError(text)

    command("echo", lambda **_: click.echo(text))
    command("styled", lambda **_: click.secho(text, fg="red", err=True))
    command("console", lambda **_: terminal.console.print(text))
    command("errors", lambda **_: terminal.error_console.print(text, style="bold red", markup=False))
    command("write", lambda **_: sys.stdout.write(text))
    written = terminal.write_json({"text": text, text: [text]})
    command("json", lambda **_: click.echo(written))
    command("plain-json", lambda **_: click.echo(json.dumps({"text": text, text: [text]}, ensure_ascii=False)))
    command("ask", lambda **_: terminal.ask_for(text or "?"))
    command("log", lambda **_: structlog.get_logger("x").warning(text or "x", text=text, more=[text]))
    command("refused", terminal.handle_errors(refused))
    command("wrong", wrong)
    # As a group finds it: by its table first.
    root.get_command = lambda _ctx, name: root.commands.get(name)  # type: ignore[method-assign]
    return root


SPEAKING = ["echo", "styled", "console", "errors", "write", "json", "plain-json", "ask", "log", "refused", "wrong"]


@pytest.mark.parametrize("name", SPEAKING)
@given(text=ANY_TEXT)
@example(HOSTILE)
@example("[/red]")
def test_no_command_lets_a_control_through(name, text):
    result = CliRunner().invoke(commands(text), [name], input="x\n", color=True)
    assert controls_in(result.stdout + result.stderr) == set()


@pytest.mark.parametrize(
    ("name", "find"),
    [("json", None), ("plain-json", None), ("refused", "detail"), ("wrong", "detail")],
)
@given(text=ANY_TEXT)
@example(HOSTILE)
def test_json_stays_json_with_the_same_value(name, find, text):
    text += "."
    result = CliRunner().invoke(commands(text), [name, "--json"])
    found = json.loads(result.stdout)
    assert controls_in(result.stdout) == set()
    assert (found["text"] == text and found[text] == [text]) if find is None else found["error"][find] == text


def test_streams_are_given_back():
    before = sys.stdout, sys.stderr
    with safe_streams():
        assert isinstance(sys.stdout, SafeStream)
        with safe_streams():
            assert isinstance(sys.stdout, SafeStream)
            assert not isinstance(sys.stdout.trusted, SafeStream)
    assert (sys.stdout, sys.stderr) == before


def test_progress_is_one_line_that_moves_through_a_safe_stream_too(monkeypatch):
    written = io.StringIO()
    monkeypatch.setattr(sys, "stderr", written)
    with safe_streams():
        overwrite_line("half\x1b[2J")
        overwrite_line("whole", ends=True)
    assert written.getvalue() == "\rhalf\\u001b[2J\x1b[K\rwhole\x1b[K\n"


class _Strange:
    def __repr__(self) -> str:
        return "\x1b[2J"


def test_a_log_line_shows_no_control_of_what_it_names() -> None:
    event = {"event": "\x1b[1m", "\x07name": "\x07", "object": _Strange(), "count": 3}
    assert escape_values(None, "info", event) == {
        "event": "\\u001b[1m", "\\u0007name": "\\u0007", "object": "\\u001b[2J", "count": 3,
    }  # fmt: skip
