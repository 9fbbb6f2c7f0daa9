"""`blockrobot demo`: the whole story on embedded parts, checked at each step."""

from __future__ import annotations

import asyncio
import shlex
import signal
import sys
import time
from pathlib import Path

import click
import msgspec
from rich.status import Status

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXIT_FAILED, FOLDER, command_output, console, home_folder, print_json
from network.demo.checks import Check, CheckList, ProgressThrottle
from network.demo.report import build_summary, write_report
from network.demo.story import Demo, DemoOptions
from network.run_folder import STAGE_FILES, empty, reserved_folder

DEFAULT_DEMO_BASE_PORT = 7472
NODES_COUNT = 4
MARK = ".blockrobot-demo"
OWN_FILES = rf"(?:drive-)?events\.jsonl|patient-b\.zip|summary\.json|report\.html|{STAGE_FILES}"


@click.command()
@click.option("--out", type=FOLDER, default=Path("blockrobot-demo"), show_default=True)
@click.option(
    "--store", default="sqlite", show_default=True, help="sqlite, or mongodb://host:port for a database each."
)
@click.option("--base-port", default=DEFAULT_DEMO_BASE_PORT, show_default=True, help="The first of ten ports a node.")
@click.option("--keep", is_flag=True, help="Leave the network up and say how to use it.")
@command_output
def demo(out: Path, store: str, base_port: int, keep: bool, as_json: bool) -> None:
    """Run the whole story: four nodes, a robot, two patients, a visitor; check every step.

    Example: blockrobot demo --keep
    """
    with reserved_folder(out, MARK, OWN_FILES):
        empty(out, MARK)
        _run(out.resolve(), store, base_port, keep=keep, as_json=as_json)


def _run(place: Path, store: str, base_port: int, *, keep: bool, as_json: bool) -> None:
    status = Status("starting", console=console)

    def show(check: Check) -> None:
        if not as_json:
            mark = "[green]✓[/green]" if check.ok else "[red]✗[/red]"
            console.print(f"{mark} {escape(check.name)}: {escape(check.detail)}")

    pace = ProgressThrottle()

    def on_progress(line: str) -> None:
        if not as_json:
            status.update(escape(line))
            if not console.is_terminal and pace.lets_pass(line, time.monotonic()):
                console.print(f"  {escape(line)}")

    checks = CheckList(listener=show)
    options = DemoOptions(out=place, cache=home_folder() / "recordings", store=store, base_port=base_port, keep=keep)
    story = Demo(options, checks, on_progress)
    if not as_json and console.is_terminal:
        status.start()
    # A demonstration that is told to end takes its nodes along, as it does on Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        asyncio.run(_whole(story))
    finally:
        status.stop()
    summary = build_summary(checks, story.state, nodes=NODES_COUNT, store=store, out=place)
    write_report(place, summary, story.state)
    if as_json:
        print_json(msgspec.to_builtins(summary))
    else:
        held = sum(check.ok for check in checks.checks)
        console.print(f"\n{held} of {len(checks.checks)} checks held. The report is {place / 'report.html'}.")
        if keep:
            _say_how_to_go_on(place)
    if not checks.ok:
        sys.exit(EXIT_FAILED)


async def _whole(story: Demo) -> None:
    try:
        await story.run()
    finally:
        await story.stop()


def _say_how_to_go_on(place: Path) -> None:
    network, wallets = place / "network", place / "wallets"
    lines = (
        f"  blockrobot status --dir {_typed(network)}\n"
        f"  BLOCKROBOT_PASSPHRASE_FILE={_typed(wallets / 'patient-b.passphrase')} blockrobot wallet "
        f"--wallet-dir {_typed(wallets)} --profile patient-b --genesis {_typed(network / 'genesis.json')} records\n"
        f"  blockrobot down --dir {_typed(network)}"
    )
    console.print(escape("The network is up. Try:\n" + lines))


def _typed(path: Path) -> str:
    return shlex.quote(str(path))
