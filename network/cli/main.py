"""The root command. Must never do work itself: it names the commands and where they live."""

from __future__ import annotations

import click

from network.cli.cluster_commands import down, logs, status, up


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="blockrobot")
def main() -> None:
    """BlockRobot: a permissioned ledger that gives patients control of what a social robot records of them."""


for command in (up, down, status, logs):
    main.add_command(command)
