"""The root command. Must never do work itself: it names the commands and where they live.

Commands are imported when they are called, so that a wallet's process never loads a node's code, and starts fast.
"""

from __future__ import annotations

import importlib

import click

_COMMANDS = {
    "up": ("network.cli.cluster_commands", "up"),
    "down": ("network.cli.cluster_commands", "down"),
    "status": ("network.cli.cluster_commands", "status"),
    "logs": ("network.cli.cluster_commands", "logs"),
    "demo": ("network.cli.demo_command", "demo"),
    "bench": ("network.cli.bench_commands", "bench"),
    "card": ("clients.registrar.cli", "card"),
    "roster": ("clients.registrar.cli", "roster"),
    "wallet": ("clients.wallet.cli", "wallet"),
    "robot": ("clients.robot.cli", "robot"),
    "reference": ("network.cli.reference_command", "reference"),
}


class LazyGroup(click.Group):
    """A group whose commands are imported on first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        """Return the names of all commands."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import and return a command, or None for an unknown name."""
        if cmd_name not in _COMMANDS:
            return None
        module, attribute = _COMMANDS[cmd_name]
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="blockrobot")
def main() -> None:
    """BlockRobot: a permissioned ledger that gives patients control of what a social robot records of them."""


if __name__ == "__main__":
    main()
