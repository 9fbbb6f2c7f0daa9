"""The root command. Must never do work itself: it names the commands and where they live.

Commands are imported when they are called, so that a wallet's process never loads a node's code, and starts fast.
"""

from __future__ import annotations

import click

from network.cli.root_group import RootGroup

_COMMANDS = {
    "up": ("network.cli.cluster_commands", "up"),
    "down": ("network.cli.cluster_commands", "down"),
    "status": ("network.cli.cluster_commands", "status"),
    "logs": ("network.cli.cluster_commands", "logs"),
    "console": ("network.cli.console_command", "console"),
    "node": ("network.cli.node_commands", "node"),
    "fault": ("network.cli.fault_commands", "fault"),
    "demo": ("network.cli.demo_command", "demo"),
    "org": ("network.cli.org_commands", "org"),
    "producer": ("network.cli.producer_commands", "producer"),
    "settings": ("network.cli.settings_commands", "settings"),
    "frames": ("network.cli.frames_commands", "frames"),
    "notice": ("network.cli.notice_commands", "notice"),
    "contract": ("network.cli.contract_commands", "contract"),
    "certificate": ("network.cli.certificate_commands", "certificate"),
    "doctor": ("network.cli.doctor_command", "doctor"),
    "explore": ("network.cli.explore_command", "explore"),
    "bench": ("network.cli.bench_commands", "bench"),
    "custody": ("network.cli.custody_commands", "custody"),
    "experiment": ("network.cli.experiment_commands", "experiment"),
    "privacy": ("network.cli.privacy_commands", "privacy"),
    "sim": ("network.cli.sim_command", "sim"),
    "card": ("clients.registrar.cli", "card"),
    "roster": ("clients.registrar.cli", "roster"),
    "wallet": ("clients.wallet.cli", "wallet"),
    "officer": ("clients.wallet.breach_commands", "officer"),
    "verify": ("clients.bundle.cli", "verify"),
    "robot": ("clients.robot.cli", "robot"),
    "completion": ("network.cli.completion_command", "completion"),
    "reference": ("network.cli.reference_command", "reference"),
}


_WITH_SECRETS = frozenset({"robot", "wallet"})
SECTIONS = {
    "Patients, and whom they share with": ("wallet", "verify"),
    "Robot operators": ("robot",),
    "Registrar's desk": ("card", "roster"),
    "Data protection officers": ("officer",),
    "Administrators of an organisation": ("org", "producer", "settings", "notice", "frames"),
    "Operators of nodes": ("up", "down", "status", "logs", "node", "certificate", "custody", "doctor"),
    "To watch and to break a network": ("console", "explore", "fault", "demo"),
    "Contract developers": ("contract",),
    "Researchers": ("experiment", "bench", "privacy", "sim"),
    "Everybody": ("completion", "reference"),
}


@click.group(
    cls=RootGroup, places=_COMMANDS, sections=SECTIONS, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(package_name="blockrobot")
@click.pass_context
def main(ctx: click.Context) -> None:
    """BlockRobot: a permissioned ledger that gives patients control of what a social robot records of them."""
    if ctx.invoked_subcommand in _WITH_SECRETS:
        from clients.sdk.process_guard import guard_process  # noqa: PLC0415 - only when it is needed

        guard_process()


if __name__ == "__main__":
    main()
