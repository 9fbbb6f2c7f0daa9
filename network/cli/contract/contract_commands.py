"""`blockrobot contract`: the group of contract commands."""

from __future__ import annotations

import click

from clients.sdk.terminal.lazy_group import LazyCommand, LazyGroup

_COMMANDS = {
    "new": LazyCommand(
        "network.cli.contract.contract_author_commands:new",
        "Begin a contract: a source that works, its test, and what editors and mypy need to know the language.",
    ),
    "check": LazyCommand(
        "network.cli.contract.contract_check_commands:check",
        "Say whether sources are in the contract language and such as a chain takes, and all that is wrong with them.",
    ),
    "vectors": LazyCommand(
        "network.cli.contract.contract_check_commands:vectors",
        "Play the golden vectors: does every call end here as it did everywhere else, to the last unit of gas?",
    ),
    "test": LazyCommand(
        "network.cli.contract.contract_author_commands:test",
        "Run the tests of contracts with pytest; show the gas of each entry and what no test has run.",
    ),
    "propose": LazyCommand(
        "network.cli.contract.contract_lifecycle_commands:propose",
        "Upload a source and propose it: a new contract, or a new version of one.",
    ),
    "approve": LazyCommand(
        "network.cli.contract.contract_lifecycle_commands:approve",
        "Stand behind a proposed change of a contract; with a majority it is decided.",
    ),
    "withdraw": LazyCommand(
        "network.cli.contract.contract_lifecycle_commands:withdraw",
        "Take back a change of a contract that your own organisation proposed.",
    ),
    "activate": LazyCommand(
        "network.cli.contract.contract_lifecycle_commands:activate",
        "Propose to bring a version back: to roll an upgrade back, or to end a disabled contract's rest.",
    ),
    "disable": LazyCommand(
        "network.cli.contract.contract_lifecycle_commands:disable",
        "Propose that a contract answers nobody any more; what it keeps stays, and changes of it that wait are dropped.",
    ),
    "keep": LazyCommand(
        "network.cli.contract.contract_lifecycle_commands:keep",
        "Propose to keep a version that is on trial: of forms, identity, lifecycle, membership, producers or settings.",
    ),
    "list": LazyCommand(
        "network.cli.contract.contract_listing_commands:list_contracts",
        "Show the chain's contracts, their versions, what is due and what is proposed, checked against proofs.",
    ),
    "show": LazyCommand(
        "network.cli.contract.contract_listing_commands:show",
        "Show a contract: its version, who proposed it, its entries; with --source its text. All of it is proved.",
    ),
    "diff": LazyCommand(
        "network.cli.contract.contract_listing_commands:diff",
        "Compare two versions of a contract: what changes for callers, and the sources line by line.",
    ),
    "trace": LazyCommand(
        "network.cli.contract.contract_trace_commands:trace",
        "Execute a final transaction again and show the lines that ran, their gas, and the values after each.",
    ),
    "call": LazyCommand(
        "network.cli.contract.contract_chain_commands:call",
        "Sign a call of a contract's entry, wait until it is final, and show the proved receipt.",
    ),
    "query": LazyCommand(
        "network.cli.contract.contract_chain_commands:query",
        "Ask a view of a contract. One node answers; its answer is not proved.",
    ),
    "events": LazyCommand(
        "network.cli.contract.contract_events_commands:events",
        "Show the events of contracts in order; each comes once, with its place. With --json one object a line.",
    ),
}


@click.group(cls=LazyGroup, places=_COMMANDS)
def contract() -> None:
    """Contracts: write, check, test and trace them; put them on a chain; call them, ask them, follow their events.

    Example: blockrobot contract query identity role_of 0x02ab... --as hospital
    """
