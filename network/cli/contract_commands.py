"""`blockrobot contract`: the group of all that concerns contracts. Must never import a command to list its name."""

from __future__ import annotations

import click

from network.cli.lazy_group import LazyGroup

_COMMANDS = {
    "new": ("network.cli.contract_author_commands", "new"),
    "check": ("network.cli.contract_check_commands", "check"),
    "vectors": ("network.cli.contract_check_commands", "vectors"),
    "test": ("network.cli.contract_author_commands", "test"),
    "propose": ("network.cli.contract_lifecycle_commands", "propose"),
    "approve": ("network.cli.contract_lifecycle_commands", "approve"),
    "withdraw": ("network.cli.contract_lifecycle_commands", "withdraw"),
    "activate": ("network.cli.contract_lifecycle_commands", "activate"),
    "disable": ("network.cli.contract_lifecycle_commands", "disable"),
    "keep": ("network.cli.contract_lifecycle_commands", "keep"),
    "list": ("network.cli.contract_listing_commands", "list_contracts"),
    "show": ("network.cli.contract_listing_commands", "show"),
    "diff": ("network.cli.contract_listing_commands", "diff"),
    "trace": ("network.cli.contract_trace_command", "trace"),
    "call": ("network.cli.contract_chain_commands", "call"),
    "query": ("network.cli.contract_chain_commands", "query"),
    "events": ("network.cli.contract_events_command", "events"),
}


@click.group(cls=LazyGroup, places=_COMMANDS)
def contract() -> None:
    """Contracts: write, check, test and trace them; put them on a chain; call them, ask them, follow their events.

    Example: blockrobot contract query identity role_of 0x02ab... --as hospital
    """
