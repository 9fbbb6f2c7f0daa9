"""`blockrobot status --watch`: a live table, or a line per change."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import time
from collections.abc import AsyncIterator, Iterator

import click
import msgspec
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import console
from network.cli.cluster.status_answers import WatchedAnswer, WatchedNode
from network.cluster import Cluster
from network.cluster_monitor import STUCK_AFTER_S, NodeObservation, NodeRow, Observer, Picture, changes
from network.faults.control import FaultControl

INTERVAL_S = 0.5
_ANSWER_S = 1.0
_COLUMNS = ("node", "state", "height", "final", "round", "epoch", "leads", "peers", "waiting", "faults")
_TEXT_COLUMNS = frozenset({"node", "state", "leads", "faults"})


async def watch(cluster: Cluster, *, as_json: bool, seconds: float | None) -> None:
    if as_json or not console.is_terminal:
        await _tell_changes(cluster, as_json=as_json, seconds=seconds)
    else:
        await _show_table(cluster, seconds)


async def _pictures(cluster: Cluster, seconds: float | None) -> AsyncIterator[Picture]:
    control, observer = FaultControl(cluster), Observer(time.monotonic())
    deadline_s = None if seconds is None else time.monotonic() + seconds
    while True:
        started_s = time.monotonic()
        yield observer.update(await _look(cluster, control), time.monotonic())
        if deadline_s is not None and time.monotonic() >= deadline_s:
            return
        await asyncio.sleep(max(0.0, started_s + INTERVAL_S - time.monotonic()))


async def _look(cluster: Cluster, control: FaultControl) -> list[NodeObservation]:
    reports, states = await asyncio.gather(cluster.status(timeout_s=_ANSWER_S), control.state())
    faults = {state.name: state for state in states}
    return [
        NodeObservation(
            name=report.name,
            running=report.running,
            paused=faults[report.name].paused,
            status=report.status,
            faults=tuple(word for word in faults[report.name].describe() if word not in {"down", "paused"}),
        )
        for report in reports
    ]


def picture_answer(picture: Picture, lines: list[str]) -> WatchedAnswer:
    """Return a picture for programs, with what changed; times are rounded to milliseconds."""
    return WatchedAnswer(
        at_s=round(picture.at_s, 3),
        finalized_height=picture.finalized_height,
        finality_age_s=round(picture.finality_age_s, 3),
        stuck_s=round(picture.stuck_s, 3),
        longest_stuck_s=round(picture.longest_stuck_s, 3),
        nodes=[msgspec.convert(row, WatchedNode, from_attributes=True) for row in picture.rows],
        changes=lines,
    )


async def _tell_changes(cluster: Cluster, *, as_json: bool, seconds: float | None) -> None:
    before: Picture | None = None
    async for picture in _pictures(cluster, seconds):
        lines = changes(before, picture)
        if as_json:
            if lines or before is None or picture.finalized_height != before.finalized_height:
                line = msgspec.to_builtins(picture_answer(picture, lines), builtin_types=(bytes,))
                click.echo(json.dumps(line, ensure_ascii=False))
        else:
            for line in lines:
                click.echo(f"{picture.at_s:8.1f} s  {line}")
        sys.stdout.flush()
        before = picture


async def _show_table(cluster: Cluster, seconds: float | None) -> None:
    with _quit_key() as quit_pressed, Live(console=console, screen=True, auto_refresh=False) as live:
        pictures = _pictures(cluster, seconds)
        try:
            async for picture in pictures:
                live.update(render(picture, str(cluster.folder)), refresh=True)
                if quit_pressed.is_set():
                    return
        finally:
            await pictures.aclose()  # type: ignore[attr-defined]


@contextlib.contextmanager
def _quit_key() -> Iterator[asyncio.Event]:
    import termios  # noqa: PLC0415 - not on every system, and only for a terminal
    import tty  # noqa: PLC0415

    pressed, loop, keyboard = asyncio.Event(), asyncio.get_running_loop(), sys.stdin.fileno()
    if not sys.stdin.isatty():
        yield pressed
        return

    def read() -> None:
        if os.read(keyboard, 1) in {b"q", b"Q", b"\x1b"}:
            pressed.set()

    before = termios.tcgetattr(keyboard)
    tty.setcbreak(keyboard)
    loop.add_reader(keyboard, read)
    try:
        yield pressed
    finally:
        loop.remove_reader(keyboard)
        termios.tcsetattr(keyboard, termios.TCSADRAIN, before)


def render(picture: Picture, folder: str) -> Group:
    table = Table(title=f"Network in {escape(folder)}", title_justify="left")
    for column in _COLUMNS:
        table.add_column(column, justify="left" if column in _TEXT_COLUMNS else "right")
    for row in picture.rows:
        table.add_row(*_cells(row))
    return Group(table, _finality_line(picture), Text("q quits", style="dim"))


def _cells(row: NodeRow) -> list[str]:
    state = "accused" if row.state == "signing" and row.accused_by else row.state
    is_lying = any(fault.startswith("byzantine") for fault in row.faults)
    style = "green" if state == "signing" and not is_lying else "yellow" if state in {"waiting", "paused"} else "red"
    figures = (row.height, row.finalized_height, row.round, row.epoch, row.leader, row.peers, row.waiting)
    shown = ["-" if figure is None else str(figure) for figure in figures]
    return [row.name, f"[{style}]{escape(state)}[/{style}]", *shown, escape("; ".join(row.faults)) or "-"]


def _finality_line(picture: Picture) -> Text:
    if picture.stuck_s >= STUCK_AFTER_S:
        return Text(f"Nothing has become final for {picture.stuck_s:.1f} s, and work waits.", style="red")
    age = f"Final height {picture.finalized_height}, {picture.finality_age_s:.1f} s ago."
    return Text(f"{age} Longest time without finality seen: {picture.longest_stuck_s:.1f} s.")
