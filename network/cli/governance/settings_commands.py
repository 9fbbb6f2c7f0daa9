"""`blockrobot settings`: chain settings; the contract decides, shown ranges are informative."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from typing import Any

import click

from clients.sdk.chain.governance import (
    MembershipView,
    ProducersView,
    read_membership,
    read_producers,
    settings_in_force,
)
from clients.sdk.network_client import NetworkClient
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, console, print_answer
from consensus.primitives.keys import PrivateKey
from network.cli.governance.governance_answers import SettingsListAnswer
from network.cli.governance.governance_signer import (
    AdminOptions,
    Signer,
    decide_on_proposal,
    governing_options,
    plain_table,
    print_proposals,
    proposal_answer,
    propose_once,
    report_decision,
    summary_of,
    withdraw_command,
)
from network.cli.governance.quorum_check import anyway_option, check_setting

_NUMBER = re.compile(r"-?[0-9]{1,70}", re.ASCII)
_MEANINGS = {
    "base_timeout_ms": ("50 to the cap", "when a round is given up"),
    "timeout_cap_ms": ("1000 to 60000", "that, after many lost rounds"),
    "heartbeat_ms": ("1 to 3600000", "an idle chain's empty block"),
    "min_block_interval_ms": ("below the base", "the pause between two blocks"),
    "max_clock_drift_ms": ("500 to 60000", "how far ahead a block may be"),
    "blocks_per_turn": ("1 to 100", "blocks before the next turn"),
    "production": ("or interval:MS", "when blocks are made"),
    "max_producers": ("1 to 21", "candidates with a seat"),
    "robot_staged_max_mib": ("1 to 1048576", "a robot's clips that are not recorded yet"),
    "robot_staged_max_count": ("1 to 1000000", "the same, their number"),
    "robot_day_max_mib": ("1 to 1073741824", "what a robot may upload a day"),
    "organisation_staged_max_mib": ("1 to 1048576", "all robots of an organisation: not recorded yet"),
    "organisation_staged_max_count": ("1 to 1000000", "the same, their number"),
    "organisation_day_max_mib": ("1 to 1073741824", "what they may upload a day"),
    "custody_copies": ("0, or 2 to 64", "custodians that keep a clip; 0: 3, or all of fewer"),
}


@click.group()
def settings() -> None:
    """The chain's settings: what is in force, and what organisations propose.

    Example: blockrobot settings propose base_timeout_ms 800 --as hospital
    """


@settings.command("list")
@governing_options
@command_output
def list_settings(admin: AdminOptions, as_json: bool) -> None:
    """Show the settings in force and the open proposals, checked against proofs.

    Example: blockrobot settings list --json
    """

    async def read(client: NetworkClient, key: PrivateKey) -> tuple[ProducersView, MembershipView]:
        return await read_producers(client, key), await read_membership(client, key)

    producers, membership = admin.read(read)
    values = settings_in_force(producers)
    proposals = [row for row in membership.proposals if row.contract == "settings"]
    if as_json:
        answer = SettingsListAnswer(
            height=producers.height,
            epoch=producers.epoch.number,
            since_height=producers.since_height,
            settings=values,
            proposals=[proposal_answer(row, membership.majority) for row in proposals],
        )
        print_answer(answer)
        return
    title = f"Settings of epoch {producers.epoch.number}, as of height {producers.height}"
    table = plain_table(title, ["setting", "value", "may be", "meaning"])
    for name, value in values.items():
        table.add_row(name, escape(str(value)), *_MEANINGS.get(name, ("", "")))
    console.print(table)
    print_proposals(proposals, membership.majority, "settings")


def _read_value(text: str) -> int | str:
    return int(text) if _NUMBER.fullmatch(text) else text


async def _check(
    signer: Signer, anyway: bool, client: NetworkClient, _: MembershipView, _kind: str, arguments: Mapping[str, Any]
) -> None:
    if not anyway:
        await check_setting(client, signer.folder, signer.key, arguments["name"], arguments["value"])


@settings.command(context_settings={"ignore_unknown_options": True})  # a value may begin with a minus
@click.argument("name")
@click.argument("value")
@anyway_option
@governing_options
@command_output
def propose(name: str, value: str, anyway: bool, admin: AdminOptions, as_json: bool) -> None:
    """Propose a value for a setting; a majority of the organisations puts it into force.

    Fewer seats are refused while too few of the producers left over are well, unless you say --anyway.

    Example: blockrobot settings propose base_timeout_ms 800 --as hospital
    """
    signer = admin.signer()
    wanted = _read_value(value.strip())
    submitted = propose_once(
        signer, "settings", "set", {"name": name, "value": wanted}, partial(_check, signer, anyway)
    )
    report_decision(submitted, f"{name} = {wanted}", "settings", as_json=as_json)


@settings.command()
@click.argument("proposal")
@anyway_option
@governing_options
@command_output
def approve(proposal: str, anyway: bool, admin: AdminOptions, as_json: bool) -> None:
    """Stand behind a proposed setting (named by the first digits of its id).

    Fewer seats are refused while too few of the producers left over are well, unless you say --anyway.

    Example: blockrobot settings approve 3fa2c19b07de --as university
    """
    signer = admin.signer()
    submitted, row = decide_on_proposal(signer, "settings", proposal, "approve", partial(_check, signer, anyway))
    report_decision(submitted, summary_of(row), "settings", as_json=as_json)


settings.add_command(withdraw_command("settings", "a setting"))
