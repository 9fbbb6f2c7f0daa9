"""`blockrobot genesis`: several parties found a network, each with its keys at home."""

from __future__ import annotations

import shlex
from contextlib import nullcontext
from pathlib import Path

import click

from clients.sdk.new_files import write_new_file
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import (
    EXISTING_FILE,
    FILE,
    FOLDER,
    command_output,
    console,
    load_genesis,
    print_answer,
    print_line,
)
from consensus.chain.genesis import ChainSettings, Genesis, genesis_to_json
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import folder_option, network_folder
from network.cli.governance.governance_answers import GenesisAnswer, GenesisNode, GenesisOrganisation, GenesisWarning
from network.cli.governance.governance_signer import plain_table
from network.provisioning.authority_check import fingerprints
from network.provisioning.founding import (
    adopt_genesis,
    check_genesis,
    find_differences,
    find_own_differences,
    find_own_entries,
    fingerprint,
    make_genesis,
    require_begun,
    unstarted,
)
from network.provisioning.founding_entries import NodeOffer, read_offers
from network.provisioning.node_certificates import now_ms
from pages.listening import is_loopback
from pages.time_format import format_time

DIFFERENCES_SHOWN_COUNT = 8
_KEY_SHOWN_CHARS = 16


@click.group()
def genesis() -> None:
    """Found a network of several parties: make the genesis file of everybody's entries, check it, and begin with it.

    Example: blockrobot genesis make entries/*.json --out genesis.json
    """


@genesis.command()
@click.argument("entries", nargs=-1, required=True, type=EXISTING_FILE)
@click.option("--out", required=True, type=FILE, help="The genesis file: a new one.")
@click.option("--network", default="blockrobot", show_default=True, help="What the network is called.")
@click.option(
    "--without-node",
    "nodeless",
    multiple=True,
    metavar="ORG",
    help="An organisation that founds with a voice and no node, on purpose; repeatable.",
)
@command_output
def make(entries: tuple[Path, ...], out: Path, network: str, nodeless: tuple[str, ...], as_json: bool) -> None:
    """Make the genesis file of all parties' entries, which `org new` and `node init --founding` wrote.

    The same entries make the same file, whoever makes it and in whatever order, so everybody may make their own. An
    organisation without a node is warned of (FOUNDER_WITHOUT_NODE): a node's entry may be missing. So is a loopback
    address among others (FOUNDER_ADDRESS_LOCAL).

    Example: blockrobot genesis make hospital/*.json university/*.json --out genesis.json
    """
    made = make_genesis(*read_offers(entries), network=network)
    unknown = sorted({*nodeless} - {entry.name for entry in made.organisations})
    if unknown:
        raise click.UsageError(f"There is no entry of the organisation {unknown[0]!r}, which --without-node names.")
    require_begun(made, now_ms())
    write_new_file(out, genesis_to_json(made).encode(), private=False)
    _show(made, out, adopted=[], as_json=as_json, nodeless=nodeless)
    if not as_json:
        step = f"blockrobot genesis check {shlex.quote(str(out))} --adopt"
        console.print(f"Next step, for each party: {escape(step)}", soft_wrap=True)


@genesis.command()
@click.argument("file", type=EXISTING_FILE)
@click.option("--adopt", is_flag=True, help="Let the nodes that are here begin with it, if all is as it should be.")
@click.option(
    "--data-dir",
    "data_dirs",
    multiple=True,
    type=FOLDER,
    help="A node that is not in the network's folder; repeatable.",
)
@folder_option
@command_output
def check(file: Path, adopt: bool, data_dirs: tuple[Path, ...], folder: Path | None, as_json: bool) -> None:
    """Check a genesis file: whether the entries that were made here are in it unchanged, and nothing else in their name.

    Everything that a founder agrees to is shown: who has a voice, by which keys and authority, nodes and custodians, the
    settings that are not the default (with --json: all), purposes, and when it begins. A file that was adopted too early
    is replaced by the next one that is adopted, as long as no node here has started.

    All parties have the same file if they see the same fingerprint: read it out to each other on the telephone.

    Example: blockrobot genesis check genesis.json --adopt
    """
    offered, place = load_genesis(file), network_folder(folder)
    check_genesis(offered)
    require_begun(offered, now_ms())
    organisations, nodes = read_offers(find_own_entries(place, data_dirs, offered))
    differences = list(find_own_differences(offered, organisations, nodes))
    if differences:
        raise _differs(f"{file} says otherwise than the entries here", differences)
    adopted, is_replaced = _adopt(offered, place, nodes) if adopt else ([], False)
    _show(offered, file, adopted, as_json=as_json, nodeless=(), is_replaced=is_replaced)
    if as_json:
        return
    if is_replaced:
        console.print("It takes the place of the genesis file that was adopted before.")
    if not nodes:
        console.print(f"No entry was made in {escape(str(place))}: there was nothing to compare.")
    for name in adopted:
        run = name if (place / "nodes" / name).is_dir() else ""
        where = "" if folder is None else f" --dir {shlex.quote(str(folder))}"
        done = f"{run} --detach{where}" if run else "DATA_DIRECTORY"
        console.print(f"Next step: blockrobot node run {escape(done)}", soft_wrap=True)


def _adopt(offered: Genesis, place: Path, nodes: list[NodeOffer]) -> tuple[list[str], bool]:
    """Return which nodes begin with it, and whether they had another one. Raises GENESIS_IN_USE, NOT_FOUND."""
    if not nodes:
        raise BlockRobotError("NOT_FOUND", f"There is no node in {place} that could begin with it.")
    folders = [Path(node.source).parent for node in nodes]
    there = [home / "genesis.json" for home in (place, *folders) if (home / "genesis.json").is_file()]
    differing = [(path, found) for path in there if (found := find_differences(load_genesis(path), offered))]
    with unstarted(place, folders) if differing else nullcontext("") as begun:
        if begun:
            earlier, differences = differing[0]
            raise _differs(f"{earlier} is another one, and {begun}", differences, "GENESIS_IN_USE")
        adopt_genesis(offered, place, folders)
    return [node.entry.name for node in nodes], bool(differing)


def _differs(what: str, differences: list[str], code: str = "GENESIS_DIFFERS") -> BlockRobotError:
    more = len(differences) - DIFFERENCES_SHOWN_COUNT
    shown = [*differences[:DIFFERENCES_SHOWN_COUNT], *([f"{more} more"] if more > 0 else [])]
    return BlockRobotError(code, f"{what}: {'; '.join(shown)}.")


def _organisations(shown: Genesis) -> list[GenesisOrganisation]:
    return [
        GenesisOrganisation(
            name=entry.name,
            nodes=[node.name for node in shown.nodes if node.organisation == entry.name],
            custodians=[node.name for node in shown.custodians if node.organisation == entry.name],
            authorities=fingerprints(entry.ca_certificate),
            admins=[key.hex() for key in entry.admins],
            registrars=[key.hex() for key in entry.registrars],
        )
        for entry in shown.organisations
    ]


def _settings(shown: Genesis) -> dict[str, tuple[int | str, int | str]]:
    """Each setting and its default."""
    default = ChainSettings()
    return {name: (getattr(shown.settings, name), getattr(default, name)) for name in default.__struct_fields__}


def _show(
    shown: Genesis,
    file: Path,
    adopted: list[str],
    *,
    as_json: bool,
    nodeless: tuple[str, ...],
    is_replaced: bool = False,
) -> None:
    """`nodeless`: organisations without a node on purpose."""
    organisations, settings = _organisations(shown), _settings(shown)
    changed = {name: values for name, values in settings.items() if values[0] != values[1]}
    warnings = [
        GenesisWarning(
            code="FOUNDER_WITHOUT_NODE",
            detail=f"{entry.name} founds without a node: its voice counts, and its node's entry may have been left out. "
            f"If it is so on purpose: genesis make --without-node {entry.name}.",
        )
        for entry in organisations
        if not entry.nodes and entry.name not in nodeless
    ]
    local = [node for node in shown.nodes if is_loopback(node.host)]
    warnings += [
        GenesisWarning(
            code="FOUNDER_ADDRESS_LOCAL",
            detail=f"{node.name} is reached at {node.host} by its entry: from its own machine alone, and others are "
            f"elsewhere. Its organisation removes its folder, makes it anew with --bind or --advertise, and hands out its "
            "new entry; once the file is adopted, that is too late.",
        )
        for node in (local if len(local) < len(shown.nodes) else [])
    ]
    nodes = [
        GenesisNode(
            name=node.name,
            organisation=node.organisation,
            host=node.host,
            p2p_port=node.p2p_port,
            api_url=node.api_url,
            produces=bool(node.producer_key),
            is_custodian=bool(node.custodian_key),
        )
        for node in shown.nodes
    ]
    if as_json:
        answer = GenesisAnswer(
            file=str(file),
            network=shown.network,
            chain_id=shown.chain_id.hex(),
            fingerprint=fingerprint(shown),
            begins_ms=shown.created_at_ms,
            settings={name: value for name, (value, _) in settings.items()},
            changed_settings=list(changed),
            purposes=list(shown.purposes),
            organisations=organisations,
            nodes=nodes,
            warnings=warnings,
            adopted=adopted,
            replaced=is_replaced,
        )
        print_answer(answer)
        return
    owners = ", ".join(entry.name for entry in shown.organisations)
    print_line(f"The network {shown.network} of {owners}")
    for node in nodes:  # no table, which would break addresses that are to be compared
        does = [word for word, is_so in (("produces", node.produces), ("keeps clips", node.is_custodian)) if is_so]
        print_line(f"  {node.name} of {node.organisation}: {', '.join(does) or 'follows'}")
        host = f"[{node.host}]" if ":" in node.host else node.host
        print_line(f"    peers    {host}:{node.p2p_port}")
        print_line(f"    clients  {node.api_url}")
    _print_agreement(shown, organisations, changed)
    for warning in warnings:
        console.print(f"[yellow]warning[/yellow] {warning.code}: {escape(warning.detail)}", soft_wrap=True)
    console.print(f"Fingerprint: {fingerprint(shown)}")


def _print_agreement(
    shown: Genesis, organisations: list[GenesisOrganisation], changed: dict[str, tuple[int | str, int | str]]
) -> None:
    """What a founder agrees to besides the nodes."""
    table = plain_table("Who has a voice", ["organisation", "nodes", "authority", "admins", "registrars"])
    for entry in organisations:
        nodes = ", ".join(entry.nodes) or "none"
        keys = [
            " ".join(key[:_KEY_SHOWN_CHARS] for key in held) or "none"
            for held in (entry.authorities, entry.admins, entry.registrars)
        ]
        table.add_row(*map(escape, (entry.name, nodes, *keys)))
    console.print(table)
    if changed:
        table = plain_table("Settings that are not the default", ["setting", "here", "default"])
        for name, values in changed.items():
            table.add_row(name, *(escape(str(value)) for value in values))
        console.print(table)
    else:
        console.print("Settings: all are the default.")
    console.print(f"Purposes: {escape(', '.join(shown.purposes))}", soft_wrap=True)
    console.print(f"Begins: {format_time(shown.created_at_ms)}")
