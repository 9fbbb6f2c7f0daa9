"""`blockrobot org`: organisations and nodes, proposed, approved and listed."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from clients.sdk.chain.governance import MembershipView, read_membership
from clients.sdk.network_client import NetworkClient
from clients.sdk.node_places import check_place, parse_place, place_of
from clients.sdk.terminal.json_answers import convert_row
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXISTING_FILE, command_output, console, print_answer
from consensus.chain.genesis import prove_possession
from consensus.errors import BlockRobotError
from consensus.primitives.keys import is_public_key
from consensus.state.membership import NodeRow, OrganisationRow
from network.cli.cluster.cluster_options import folder_option, network_folder
from network.cli.governance.governance_answers import MemberNode, MemberOrganisation, OrgListAnswer, OrgNewAnswer
from network.cli.governance.governance_signer import (
    AdminOptions,
    Signer,
    decide_on_proposal,
    governing_options,
    plain_table,
    print_proposals,
    proposal_answer,
    propose_once,
    read_private_key,
    report_decision,
    shown_id,
    summary_of,
    withdraw_command,
)
from network.cli.governance.quorum_check import anyway_option, check_membership_change
from network.provisioning.authority_check import check_authority_change, fingerprints
from network.provisioning.certificate_requests import check_fit
from network.provisioning.exchange_files import (
    ORGANISATION_ENTRY_FILE,
    read_authority_certificates,
    read_node_entry,
    read_organisation_entry,
)
from network.provisioning.new_node import EVERYWHERE, NewNode
from network.provisioning.new_organisation import create_organisation, enter_organisation
from network.provisioning.node_certificates import read_certificate
from node.config import CONFIG_FILE, NodeConfig, load_config

_FINGERPRINT_SHOWN_CHARS = 16


@click.group()
def org() -> None:
    """The organisations of the network and their nodes.

    Example: blockrobot org propose remove-node node-5 --as hospital
    """


def _organisation_answer(row: OrganisationRow, nodes: tuple[NodeRow, ...]) -> MemberOrganisation:
    own = [node.name for node in nodes if node.organisation == row.name]
    return MemberOrganisation(
        name=row.name,
        status=row.status,
        since_height=row.since_height,
        authorities=fingerprints(row.ca_certificate),
        nodes=own,
    )


@org.command("list")
@governing_options
@command_output
def list_organisations(admin: AdminOptions, as_json: bool) -> None:
    """Show organisations, nodes and open proposals, checked against proofs.

    Example: blockrobot org list --json
    """
    view = admin.read(read_membership)
    proposals = [row for row in view.proposals if row.contract == "membership"]
    if as_json:
        answer = OrgListAnswer(
            height=view.height,
            majority=view.majority,
            organisations=[_organisation_answer(row, view.nodes) for row in view.organisations],
            nodes=[convert_row(row, MemberNode) for row in view.nodes],
            proposals=[proposal_answer(row, view.majority) for row in proposals],
        )
        print_answer(answer)
        return
    title = f"Organisations, as of height {view.height}; {view.majority} make a majority"
    table = plain_table(title, ["organisation", "since height", "authority", "nodes"])
    for row in view.organisations:
        own = [node.name for node in view.nodes if node.organisation == row.name]
        authorities = " ".join(print_[:_FINGERPRINT_SHOWN_CHARS] for print_ in fingerprints(row.ca_certificate))
        table.add_row(escape(row.name), str(row.since_height), authorities, escape(", ".join(own)))
    console.print(table)
    table = plain_table("Nodes", ["node", "organisation", "peers", "since", "producer", "custodian"])
    for node in view.nodes:
        keys = [shown_id(key)[:8] if key else "-" for key in (node.producer_key, node.custodian_key)]
        cells = [node.name, node.organisation, f"{node.host}:{node.p2p_port}", str(node.since_height), *keys]
        table.add_row(*map(escape, cells))
    console.print(table)
    print_proposals(proposals, view.majority, "org")


@org.command()
@click.argument("name")
@click.option(
    "--certificate",
    type=EXISTING_FILE,
    help="The certificate (PEM) of an authority that it has elsewhere, and which signs for nodes; no key of it comes here.",
)
@folder_option
@command_output
def new(name: str, certificate: Path | None, folder: Path | None, as_json: bool) -> None:
    """Make an organisation's folder on this machine: its certificate authority, an admin's and a registrar's key.

    The folder stays with its owner. What others need of it is in organisation-entry.json, which holds no secret.

    Example: blockrobot org new clinic
    """
    place = network_folder(folder)
    if certificate is None:
        _, entry = create_organisation(place, name)
    else:
        entry = enter_organisation(place, name, read_authority_certificates(certificate))
    path = place / "organisations" / name
    public = path / ORGANISATION_ENTRY_FILE
    if as_json:
        admins = [key.hex() for key in entry.admins]
        print_answer(OrgNewAnswer(folder=str(path), entry=str(public), admins=admins))
        return
    console.print(
        f"The organisation {escape(name)} has its keys in {escape(str(path))}. Keep its folder secret and safe."
    )
    where = "" if folder is None else f" --dir {shlex.quote(str(folder))}"
    console.print(f"Others need {ORGANISATION_ENTRY_FILE} from there: nothing in it is secret. Next step,")
    console.print(
        f"  to found a network: blockrobot node init NODE --founding --organisation {name}{escape(where)}",
        soft_wrap=True,
    )
    console.print(
        "  to join one that runs, where an organisation of it is: blockrobot org propose add-org --from "
        f"{ORGANISATION_ENTRY_FILE} --as ORG",
        soft_wrap=True,
    )


async def _check(
    signer: Signer, anyway: bool, client: NetworkClient, before: MembershipView, kind: str, arguments: Mapping[str, Any]
) -> None:
    check_authority_change(kind, arguments, before.organisations)
    if not anyway:
        await check_membership_change(client, signer.folder, signer.key, before, kind, arguments)


@org.command()
@click.argument("proposal")
@anyway_option
@governing_options
@command_output
def approve(proposal: str, anyway: bool, admin: AdminOptions, as_json: bool) -> None:
    """Stand behind a proposed change (named by the first digits of its id).

    To take nodes out, or to replace a producer's key, is refused while too few of the others are well, unless you say
    --anyway.

    Example: blockrobot org approve 3fa2c19b07de --as university
    """
    signer = admin.signer()
    submitted, row = decide_on_proposal(signer, "membership", proposal, "approve", partial(_check, signer, anyway))
    report_decision(submitted, summary_of(row), "org", as_json=as_json)


org.add_command(withdraw_command("membership", "a change"))


def _propose(kind: str, arguments: dict[str, Any], admin: AdminOptions, *, as_json: bool, anyway: bool = True) -> None:
    signer = admin.signer()
    submitted = propose_once(signer, "membership", kind, arguments, partial(_check, signer, anyway))
    named = arguments.get("name") or arguments.get("node") or arguments.get("organisation")
    report_decision(submitted, f"{kind.replace('_', '-')} {named}", "org", as_json=as_json)


@org.group()
def propose() -> None:
    """Propose a change of organisations or nodes; a majority of the organisations puts it into force.

    Example: blockrobot org propose remove-org clinic --as hospital
    """


@propose.command("add-org")
@click.argument("name", required=False)
@click.option(
    "--from",
    "source",
    type=EXISTING_FILE,
    help=f"The newcomer's {ORGANISATION_ENTRY_FILE} (see org new); else NAME's in the network's folder.",
)
@governing_options
@command_output
def add_org(name: str | None, source: Path | None, admin: AdminOptions, as_json: bool) -> None:
    """Propose a new organisation by its entry: certificate authority and public keys, nothing secret.

    Example: blockrobot org propose add-org --from organisation-entry.json --as hospital
    """
    if source is None and name is None:
        raise click.UsageError(f"Name the newcomer's {ORGANISATION_ENTRY_FILE} with --from FILE.")
    place = source or network_folder(admin.folder) / "organisations" / str(name) / ORGANISATION_ENTRY_FILE
    arguments = read_organisation_entry(place)
    if name is not None and arguments["name"] != name:
        raise BlockRobotError("FILE_UNUSABLE", f"{place} is the entry of {arguments['name']!r}, not of {name!r}.")
    _propose("add_org", arguments, admin, as_json=as_json)


@propose.command("remove-org")
@click.argument("name")
@anyway_option
@governing_options
@command_output
def remove_org(name: str, anyway: bool, admin: AdminOptions, as_json: bool) -> None:
    """Propose to remove an organisation with its nodes, keys and voice.

    Example: blockrobot org propose remove-org clinic --as hospital
    """
    _propose("remove_org", {"name": name}, admin, as_json=as_json, anyway=anyway)


@propose.command("replace-ca")
@click.argument("name")
@click.option("--certificate", required=True, type=EXISTING_FILE, help="The new CA certificate (PEM).")
@governing_options
@command_output
def replace_ca(name: str, certificate: Path, admin: AdminOptions, as_json: bool) -> None:
    """Propose a new certificate authority for an organisation. Certificates of the old one count no more.

    Only the certificates in the file are sent, written anew; a file that holds a private key too is refused.

    Example: blockrobot org propose replace-ca hospital --certificate new-ca.crt.pem --as hospital
    """
    arguments = {"organisation": name, "ca_certificate": read_authority_certificates(certificate)}
    _propose("replace_ca", arguments, admin, as_json=as_json)


@propose.command("replace-keys")
@click.argument("name")
@click.option(
    "--admin", "admins", multiple=True, required=True, help="An admin's public key (hexadecimal); repeatable."
)
@click.option("--registrar", "registrars", multiple=True, help="A registrar's public key (hexadecimal); repeatable.")
@governing_options
@command_output
def replace_keys(
    name: str, admins: tuple[str, ...], registrars: tuple[str, ...], admin: AdminOptions, as_json: bool
) -> None:
    """Propose new admins and registrars in place of all that an organisation has.

    Example: blockrobot org propose replace-keys hospital --admin 02ab... --registrar 03cd... --as hospital
    """
    arguments = {
        "organisation": name,
        "admins": [_read_public_key(key, "--admin") for key in admins],
        "registrars": [_read_public_key(key, "--registrar") for key in registrars],
    }
    _propose("replace_keys", arguments, admin, as_json=as_json)


@propose.command("add-node")
@click.option(
    "--from", "source", required=True, type=EXISTING_FILE, help="The node's entry: JSON, as `node init` writes it."
)
@governing_options
@command_output
def add_node(source: Path, admin: AdminOptions, as_json: bool) -> None:
    """Propose a new node. It produces nothing before it is voted in (producer propose).

    Example: blockrobot org propose add-node --from node-5/node-entry.json --as hospital
    """
    arguments = read_node_entry(source)
    name, host, port, url = (arguments[field] for field in ("name", "host", "p2p_port", "api_url"))
    check_place(str(name), str(host), port if isinstance(port, int) else 0, str(url))
    _propose("add_node", arguments, admin, as_json=as_json)


@propose.command("remove-node")
@click.argument("name")
@anyway_option
@governing_options
@command_output
def remove_node(name: str, anyway: bool, admin: AdminOptions, as_json: bool) -> None:
    """Propose to remove a node. Its certificate and votes count no more from the height at which that takes effect.

    Example: blockrobot org propose remove-node node-5 --as hospital
    """
    _propose("remove_node", {"name": name}, admin, as_json=as_json, anyway=anyway)


@propose.command("move-node")
@click.argument("name")
@click.option(
    "--advertise", required=True, metavar="HOST:PORT", help="Where peers reach it, and clients at the port after it."
)
@click.option("--api-url", default="", metavar="URL", help="Where clients reach it, if elsewhere.")
@governing_options
@command_output
def move_node(name: str, advertise: str, api_url: str, admin: AdminOptions, as_json: bool) -> None:
    """Say where a node is reached from now on. For a node of its own an organisation needs nobody else.

    Nodes and clients follow. Its certificate has to name the new address first: certificate renew --host.

    Example: blockrobot org propose move-node node-5 --advertise node-5.clinic.example:7272 --as clinic
    """
    host, port = parse_place(advertise)
    if not port:
        raise click.UsageError("--advertise takes HOST:PORT.")
    new = NewNode(name, "", host, port, api_url=api_url)
    new.check()
    _, _, url = new.reached_at
    arguments = {"name": name, "host": host, "p2p_port": port, "api_url": url}
    data_dir = network_folder(admin.folder) / "nodes" / name
    _check_own_certificate(data_dir, (host, place_of(url)[0]))
    _propose("move_node", arguments, admin, as_json=as_json)
    if (data_dir / CONFIG_FILE).is_file():
        _tell_listening(name, load_config(data_dir), host, port)


def _tell_listening(name: str, config: NodeConfig, host: str, port: int) -> None:
    if config.p2p_port == port and config.host in {host, *EVERYWHERE}:
        return
    step = f"blockrobot down {name}; blockrobot node run {name} --detach"
    told = f"{name} listens at {config.host}:{config.p2p_port}. Unless connections to {host}:{port} are passed on"
    click.echo(f"{told} to it, change [listen] in its node.toml, and start it again: {step}", err=True)


def _check_own_certificate(data_dir: Path, hosts: Sequence[str]) -> None:
    """Of a node whose folder is here. Raises CERTIFICATE_UNFIT."""
    if not (data_dir / CONFIG_FILE).is_file():
        return
    try:
        check_fit(read_certificate(load_config(data_dir)), hosts)
    except BlockRobotError as error:
        named = "".join(f" --host {host}" for host in dict.fromkeys(hosts))
        step = f"First: blockrobot certificate renew {data_dir.name}{named} (and a --host for each address it has now)."
        raise BlockRobotError(error.code, f"{error.detail} {step}") from None


@propose.command("rekey-producer")
@click.argument("node")
@click.option(
    "--producer-key", "secret", required=True, type=EXISTING_FILE, help="The new producer key's file; stays here."
)
@anyway_option
@governing_options
@command_output
def rekey_producer(node: str, secret: Path, anyway: bool, admin: AdminOptions, as_json: bool) -> None:
    """Propose a new producer key for a node, with proof that it is held. The old one counts no more.

    The node is silent until it has the new key; that is refused while the others cannot do without it, unless you say
    --anyway.

    Example: blockrobot org propose rekey-producer node-2 --producer-key new-producer.key --as university
    """
    key = read_private_key(secret)
    proof = prove_possession(key, node)
    arguments = {"node": node, "producer_key": key.public_key, "producer_possession": proof}
    _propose("rekey_producer", arguments, admin, as_json=as_json, anyway=anyway)


def _read_hex(text: str, option: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise click.UsageError(f"{option} takes hexadecimal digits.") from None


def _read_public_key(text: str, option: str) -> bytes:
    key = _read_hex(text, option)
    if not is_public_key(key):
        raise click.UsageError(f"{option} takes a public key: 33 bytes that somebody can have the secret half of.")
    return key
