"""`blockrobot node init | directory`: joining nodes and the directory."""

from __future__ import annotations

import shlex
import time
from dataclasses import replace
from pathlib import Path

import click

from clients.sdk.new_files import read_given_file, write_new_file
from clients.sdk.node_places import parse_place
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import (
    EXISTING_FILE,
    FILE,
    FOLDER,
    command_output,
    console,
    load_genesis,
    print_answer,
)
from consensus.bounded_text import JSON_MAX_BYTES, read_json_as
from consensus.chain.genesis import Genesis, NodeEntry
from network.cli.cluster.cluster_options import folder_option, genesis_steps, network_folder
from network.cli.governance.governance_signer import admin_keys, plain_table, read_private_key
from network.cli.node.node_answers import ListeningWarning, NodeDirectoryAnswer, NodeInitAnswer
from network.cli.node.node_commands import get_node_config
from network.cluster import Cluster
from network.provisioning.certificate_authority import AUTHORITY_CERTIFICATE_FILE, AUTHORITY_KEY_FILE
from network.provisioning.exchange_files import ORGANISATION_ENTRY_FILE
from network.provisioning.network_layout import FIRST_PORT, PORTS_PER_NODE
from network.provisioning.new_node import (
    NODE_ENTRY_FILE,
    REQUEST_FILE,
    Founder,
    NewNode,
    create_node,
    find_listening_troubles,
)
from network.provisioning.new_organisation import ADMIN_KEY_FILE
from network.provisioning.node_certificates import get_authority
from network.provisioning.node_joining import init_node, newest_directory, next_base_port, of_chain
from node.config import CONFIG_FILE, load_config
from node.directory.directory_file import DIRECTORY_FILE, decode_directory, encode_directory


@click.command()
@click.argument("name")
@click.option("--organisation", required=True, help="Whose node it is; its authority signs the certificate.")
@click.option(
    "--data-dir", type=FOLDER, help="Where the node keeps all that is its own; else nodes/NAME in the network's folder."
)
@click.option("--bind", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Where it listens.")
@click.option(
    "--advertise",
    default="",
    metavar="HOST[:PORT]",
    help="Where peers reach it, and clients at the port after it; else where it listens.",
)
@click.option("--api-url", default="", metavar="URL", help="Where clients reach it, if elsewhere: a proxy, say.")
@click.option(
    "--api-bind", default="", metavar="ADDRESS", help="Where it listens for clients, if elsewhere: 127.0.0.1, say."
)
@click.option("--base-port", type=click.IntRange(1, 65_533), help="The first of its three ports; else the next free.")
@click.option("--custodian", is_flag=True, help="It keeps off-chain data too.")
@click.option("--store", default="sqlite", show_default=True, help="A custodian's store: sqlite or mongodb://...")
@click.option("--authority", type=FOLDER, help="The folder with the CA's files.")
@click.option("--genesis", type=FILE, help="The genesis file; else the network folder's.")
@click.option(
    "--directory",
    "directory_file",
    type=EXISTING_FILE,
    help=f"A {DIRECTORY_FILE} of another machine (see node directory), if the network is older than its genesis file.",
)
@click.option(
    "--founding",
    is_flag=True,
    help="It founds a network, whose genesis file is made of its entry and others' (blockrobot genesis).",
)
@click.option("--follower", is_flag=True, help="With --founding: it follows the chain and produces no blocks.")
@click.option(
    "--faults", is_flag=True, help="Allow it to be broken on purpose (blockrobot fault). For experiments only."
)
@folder_option
@command_output
def init(
    name: str,
    organisation: str,
    data_dir: Path | None,
    bind: str,
    advertise: str,
    api_url: str,
    api_bind: str,
    base_port: int | None,
    custodian: bool,
    store: str,
    authority: Path | None,
    genesis: Path | None,
    directory_file: Path | None,
    founding: bool,
    follower: bool,
    faults: bool,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Make the data directory of a node: one that joins a network which runs already, or with --founding a first one.

    One that joins follows the chain once the organisations have agreed on it, and produces blocks once they vote for it.

    Examples: blockrobot node init node-5 --organisation hospital; blockrobot node init ward-1 --founding --organisation
    hospital --bind 0.0.0.0 --advertise ward-1.hospital.example --custodian
    """
    network = network_folder(folder)
    host, port = parse_place(advertise or bind)
    new = NewNode(
        name=name,
        organisation=organisation,
        host=host,
        base_port=base_port or FIRST_PORT,
        store=store,
        is_custodian=custodian,
        is_producer=not follower,
        faults=faults,
        api_url=api_url,
        bind=bind,
        api_bind=api_bind,
        p2p_port=port,
    )
    if founding:
        if genesis is not None or directory_file is not None:
            raise click.UsageError("A network that is to be founded has no genesis file yet.")
        home = (data_dir or network / "nodes" / name).resolve()
        _init_founding(new, network, folder, home, authority, base_port, as_json=as_json)
        return
    if follower:
        raise click.UsageError("A node that joins produces no blocks until it is voted in.")
    beginning = load_genesis(genesis or network / "genesis.json")
    is_elsewhere = not _is_home(network, beginning)
    if is_elsewhere and (data_dir is None or authority is None):
        raise click.UsageError(f"{network} is another network: name --data-dir and --authority as well.")
    configs = list(Cluster(network).configs.values()) if (network / "genesis.json").is_file() else []
    known = newest_directory(beginning, of_chain(configs, beginning.chain_id))
    if directory_file is not None:
        directory_content = decode_directory(read_given_file(directory_file, JSON_MAX_BYTES), beginning.chain_id)
        known = max(known, directory_content, key=lambda content: content.height)
    if base_port is None:
        new = replace(new, base_port=next_base_port(known, configs))
    place = (data_dir or network / "nodes" / name).resolve()
    entry = init_node(place, new, beginning, get_authority(network, organisation, authority), known)
    speaker = _speaker(organisation, None if is_elsewhere else network, authority)
    steps = next_steps(name, speaker, place, None if data_dir is not None else network, folder)
    steps[:0] = [f"{step}   (commands look there)" for step in genesis_steps(network, place)]
    _show_made(entry, new, place, steps, as_json=as_json)


def _init_founding(
    new: NewNode,
    network: Path,
    folder: Path | None,
    place: Path,
    authority: Path | None,
    base_port: int | None,
    *,
    as_json: bool,
) -> None:
    home = authority or network / "organisations" / new.organisation
    admin = read_private_key(home / ADMIN_KEY_FILE)
    if base_port is None:
        ports = [load_config(path.parent).p2p_port for path in network.glob(f"nodes/*/{CONFIG_FILE}")]
        new = replace(new, base_port=max(ports, default=FIRST_PORT - PORTS_PER_NODE) + PORTS_PER_NODE)
    founder = Founder(admin, time.time_ns() // 1_000_000)
    is_held = (home / AUTHORITY_KEY_FILE).is_file() or not (home / AUTHORITY_CERTIFICATE_FILE).is_file()
    signer = get_authority(network, new.organisation, authority) if is_held else None
    entry = create_node(place, new, signer, founder=founder)
    where = "" if folder is None else f" --dir {shlex.quote(str(folder))}"
    is_elsewhere = place.parent != (network / "nodes").resolve()
    data_dir = f" --data-dir {shlex.quote(str(place))}" if is_elsewhere else ""
    run = shlex.quote(str(place)) if is_elsewhere else f"{new.name} --detach{where}"
    steps = [
        f"Hand {home / ORGANISATION_ENTRY_FILE} and {place / NODE_ENTRY_FILE} to the other founders, and take theirs",
        "blockrobot genesis make ENTRY... --out genesis.json   (all entries; each party, or one for all)",
        f"blockrobot genesis check genesis.json --adopt{data_dir}{where}   (and compare fingerprints on the telephone)",
        f"blockrobot node run {run}",
    ]
    if signer is None:
        named = shlex.quote(str(place)) if is_elsewhere else new.name
        at = "" if authority is None else f" --authority {shlex.quote(str(authority))}"
        steps[:0] = [
            f"Let the authority of {new.organisation} sign {place / REQUEST_FILE}, which holds no secret",
            f"blockrobot certificate install {named} CERTIFICATE{at}{where}   (it signs the entry)",
        ]
    _show_made(entry, new, place, steps, as_json=as_json)


def _show_made(entry: NodeEntry, new: NewNode, place: Path, steps: list[str], *, as_json: bool) -> None:
    troubles = find_listening_troubles(new)
    if as_json:
        answer = NodeInitAnswer(
            node=entry.name,
            data_dir=str(place),
            entry=str(place / NODE_ENTRY_FILE),
            request=str(place / REQUEST_FILE) if (place / REQUEST_FILE).is_file() else None,
            producer_key=entry.producer_key.hex(),
            custodian_key=entry.custodian_key.hex(),
            next_steps=steps,
            warnings=[ListeningWarning(code=trouble.code, detail=trouble.detail) for trouble in troubles],
        )
        print_answer(answer)
        return
    for trouble in troubles:
        told = f"{trouble.code}: {trouble.detail} {trouble.entry.next_step}"
        console.print(f"[yellow]warning[/yellow] {escape(told)}", soft_wrap=True)
    console.print(f"The node {entry.name} of {escape(entry.organisation)} is in {escape(str(place))}. What is next:")
    for number, step in enumerate(steps, 1):
        console.print(f"  {number}. {escape(step)}", soft_wrap=True)


def _is_home(network: Path, beginning: Genesis) -> bool:
    path = network / "genesis.json"
    return not path.is_file() or load_genesis(path).chain_id == beginning.chain_id


def _speaker(organisation: str, network: Path | None, authority: Path | None) -> str:
    if network is not None and organisation in admin_keys(network):
        return f"--as {organisation}"
    if authority is not None and (authority / ADMIN_KEY_FILE).is_file():
        return f"--key {shlex.quote(str(authority / ADMIN_KEY_FILE))}"
    return "--as ORG"


def next_steps(name: str, speaker: str, place: Path, network: Path | None, folder: Path | None) -> list[str]:
    """Commands before a new node participates; `speaker` is the signer option, `folder` --dir."""
    where = "" if folder is None else f" --dir {shlex.quote(str(folder))}"
    run = shlex.quote(str(place)) if network is None else f"{name} --detach{where}"
    return [
        f"blockrobot org propose add-node --from {shlex.quote(str(place / NODE_ENTRY_FILE))} {speaker}{where}",
        f"blockrobot org approve ID --as ORG{where}   (the id that propose prints; until a majority stands behind it)",
        f"blockrobot node run {run}   (it fetches the chain and follows it)",
        f"blockrobot producer propose {name} {speaker}{where}   (only if it is to produce blocks)",
        f"blockrobot producer approve {name} --as ORG{where}   (until a majority has voted for it)",
    ]


@click.command("directory")
@click.argument("node")
@click.option("--out", type=FILE, help="Write it to this new file.")
@folder_option
@command_output
def directory(node: str, out: Path | None, folder: Path | None, as_json: bool) -> None:
    """Show who the nodes are by a node's chain; with --out, write it for `node init --directory` elsewhere.

    Example: blockrobot node directory node-1 --out directory.json
    """
    config = get_node_config(node, folder)
    genesis = load_genesis(config.genesis_path)
    content = newest_directory(genesis, [config])
    data = encode_directory(genesis.chain_id, content)
    if out is not None:
        write_new_file(out, data, private=False)
    if as_json:
        print_answer(read_json_as(data, NodeDirectoryAnswer))
        return
    table = plain_table(f"Nodes as of height {content.height}", ["node", "organisation", "peers", "clients", "state"])
    for item in content.nodes.values():
        state = "active" if content.is_active(item) else "removed"
        cells = [item.name, item.organisation, f"{item.host}:{item.p2p_port}", item.api_url, state]
        table.add_row(*map(escape, cells))
    console.print(table)
