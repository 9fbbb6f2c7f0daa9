"""`blockrobot certificate`: certificates by which nodes authenticate one another.

Issue and renewal are local to an organisation; revocation is a transaction.
"""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import click
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from clients.sdk.new_files import read_given_file, write_new_file
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import (
    EXISTING_FILE,
    FILE,
    FOLDER,
    ask,
    can_ask,
    command_output,
    console,
    load_genesis,
    print_answer,
)
from consensus.bounded_text import JSON_MAX_BYTES
from consensus.chain.genesis import NodeEntry
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import folder_option, network_folder
from network.cli.governance.governance_signer import (
    AdminOptions,
    governing_options,
    plain_table,
    propose_once,
    read_private_key,
    report_decision,
)
from network.cli.node.node_answers import (
    CertificateEntry,
    CertificateIssueAnswer,
    CertificateListAnswer,
    CertificateRenewAnswer,
    CertificateRequestAnswer,
    CertificateSignAnswer,
)
from network.cli.node.node_commands import get_node_config
from network.cluster import Cluster
from network.provisioning.certificate_authority import AUTHORITY_CERTIFICATE_FILE, NODE_LIFETIME_DAYS, certified_hosts
from network.provisioning.certificate_requests import check_certificate, check_fit, make_request, sign_request
from network.provisioning.exchange_files import read_authority_certificates, read_certificate, read_public_text
from network.provisioning.new_node import (
    NODE_ENTRY_FILE,
    Founder,
    certify_founder,
    hosts_of,
    read_founding_entry,
)
from network.provisioning.new_organisation import ADMIN_KEY_FILE
from network.provisioning.node_certificates import (
    CertificateReport,
    get_authority,
    issue_into,
    now_ms,
    own_hosts,
    parse_serial,
    read_report,
    renew,
    serial_bytes,
)
from network.provisioning.node_certificates import install as install_certificate
from network.provisioning.node_joining import check_asked, newest_directory, organisation_of
from node.config import LOOPBACK, NodeConfig
from node.directory.directory_file import DIRECTORY_FILE, decode_directory
from node.directory.node_directory import DirectoryContent, DirectoryNode
from node.p2p.identity import identify_peer, read_facts

authority_option = click.option(
    "--authority", type=FOLDER, help="The folder with ca.crt.pem and ca.key.pem, if it is not in the network's folder."
)
days_option = click.option(
    "--days", default=NODE_LIFETIME_DAYS, show_default=True, type=click.IntRange(1, 3650), help="How long it counts."
)

directory_option = click.option(
    "--directory",
    "directory_file",
    type=EXISTING_FILE,
    help=f"A {DIRECTORY_FILE} of another machine (see node directory), if this node has missed a new authority.",
)


@click.group()
def certificate() -> None:
    """The certificates of nodes: list, issue, renew, revoke. NODE is a name in the network or a data directory.

    Example: blockrobot certificate renew node-2
    """


def _certificate_answer(
    report: CertificateReport, time_ms: int, revoked: frozenset[tuple[str, int]]
) -> CertificateEntry:
    facts = report.facts
    return CertificateEntry(
        node=report.node,
        state=report.state(time_ms, revoked),
        organisation="" if facts is None else facts.organisation,
        serial="" if facts is None else facts.serial_hex,
        expires="" if facts is None else facts.expires,
        days_left=report.days_left(time_ms),
        trouble=report.trouble,
    )


@certificate.command("list")
@folder_option
@command_output
def list_certificates(folder: Path | None, as_json: bool) -> None:
    """Show each node's certificate: its serial number, until when it counts, whether it was revoked.

    Example: blockrobot certificate list --json
    """
    cluster = Cluster(network_folder(folder))
    directory = newest_directory(cluster.genesis, cluster.configs.values())
    time_ms = now_ms()
    reports = [read_report(config) for config in cluster.configs.values()]
    rows = [_certificate_answer(report, time_ms, directory.revoked) for report in reports]
    if as_json:
        is_well = all(row.state in {"valid", "expiring"} for row in rows)
        print_answer(CertificateListAnswer(certificates=rows), ok=is_well)
        return
    table = plain_table(f"Certificates as of height {directory.height}", ["node", "of", "state", "expires", "serial"])
    for row in rows:
        state = f"{row.state}: {row.trouble}" if row.trouble else row.state
        table.add_row(row.node, row.organisation, escape(state), row.expires, row.serial)
    console.print(table)


@certificate.command()
@click.argument("name")
@click.option("--organisation", required=True, help="Whose node it is.")
@click.option(
    "--host",
    "hosts",
    multiple=True,
    default=(LOOPBACK,),
    show_default=True,
    help="An address or a host name at which peers or clients reach it; may be repeated.",
)
@click.option("--out", required=True, type=FOLDER, help="Where the two files are made.")
@days_option
@authority_option
@folder_option
@command_output
def issue(
    name: str,
    organisation: str,
    hosts: tuple[str, ...],
    out: Path,
    days: int,
    authority: Path | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Issue a certificate with a new key, as tls.crt.pem and tls.key.pem, for a node that has none.

    Example: blockrobot certificate issue node-7 --organisation hospital --out keys/node-7
    """
    ca = get_authority(network_folder(folder), organisation, authority)
    try:
        serial = issue_into(out, ca, name, *hosts, days=days)
    except FileExistsError:
        raise BlockRobotError("NODE_EXISTS", f"There is a certificate or a key in {out} already; renew it.") from None
    if as_json:
        print_answer(CertificateIssueAnswer(node=name, serial=f"{serial:x}", folder=str(out)))
    else:
        console.print(f"Issued {serial:x} for {escape(name)}: the certificate and its key are in {escape(str(out))}.")


@certificate.command()
@click.argument("node")
@click.option("--out", required=True, type=FILE, help="The request: a new file.")
@click.option(
    "--host", "hosts", multiple=True, help="An address that it names; may be repeated. Else those it has now."
)
@folder_option
@command_output
def request(node: str, out: Path, hosts: tuple[str, ...], folder: Path | None, as_json: bool) -> None:
    """Ask for a certificate for the key that a node has, in a file that holds no secret (PKCS #10).

    The authority of its organisation signs it, on whatever machine its key is: certificate sign, or a program of a
    hospital's own.

    Example: blockrobot certificate request node-7 --out node-7.csr
    """
    config = get_node_config(node, folder)
    organisation = _organisation(config, folder)
    named = hosts or _own_hosts(config, _known(config)[1])
    write_new_file(out, make_request(config, organisation, named), private=False)
    if as_json:
        answer = CertificateRequestAnswer(node=config.name, organisation=organisation, hosts=list(named), file=str(out))
        print_answer(answer)
        return
    console.print(f"The request of {config.name} is in {escape(str(out))}; it names {escape(', '.join(named))}.")
    console.print(
        f"Next step, at its authority: blockrobot certificate sign {escape(shlex.quote(str(out)))} "
        f"--organisation {escape(organisation)} --node {config.name} --out FILE",
        soft_wrap=True,
    )


@certificate.command()
@click.argument("request_file", metavar="REQUEST", type=EXISTING_FILE)
@click.option("--organisation", required=True, help="Whose authority signs.")
@click.option("--out", required=True, type=FILE, help="The certificate: a new file.")
@click.option("--node", metavar="NAME", help="Refuse a request of another node.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@days_option
@authority_option
@folder_option
@command_output
def sign(
    request_file: Path,
    organisation: str,
    out: Path,
    node: str | None,
    yes: bool,
    days: int,
    authority: Path | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Issue a certificate for a node's request, where the organisation's authority is.

    It shows what the request asks for, and asks: make sure that it is of the node that it names. Refused is what names
    another organisation's node, or another node besides its own, as far as the network's folder knows them.

    Example: blockrobot certificate sign node-7.csr --organisation clinic --node node-7 --out node-7.crt.pem
    """
    if not yes and not can_ask():
        raise click.UsageError("There is no terminal to ask for confirmation: give --yes.")
    place = network_folder(folder)
    ca = get_authority(place, organisation, authority)
    made = sign_request(ca, read_public_text(request_file).encode(), days)
    facts, hosts = read_facts(made), list(certified_hosts(made))
    cluster = Cluster(place) if (place / "genesis.json").is_file() else None
    known = None if cluster is None else newest_directory(cluster.genesis, cluster.configs.values())
    check_asked(facts.name, hosts, organisation, known, node)
    if not yes:
        asks = (
            f"{facts.name} of {organisation} is to be certified until {facts.expires}, reached at {', '.join(hosts)}."
        )
        click.echo(asks, err=True)
        ask("Sign it?", err=True)
    write_new_file(out, made.public_bytes(Encoding.PEM), private=False)
    if as_json:
        print_answer(CertificateSignAnswer(node=facts.name, serial=facts.serial_hex, hosts=hosts, file=str(out)))
        return
    console.print(f"{escape(facts.name)}, reached at {escape(', '.join(hosts))}, is certified until {facts.expires}.")
    console.print(
        f"Next step, where the node is: blockrobot certificate install {facts.name} {escape(shlex.quote(str(out)))}",
        soft_wrap=True,
    )


@certificate.command()
@click.argument("node")
@click.argument("certificate_file", metavar="CERTIFICATE", type=EXISTING_FILE)
@click.option(
    "--authority",
    type=FOLDER,
    help="Of a node that founds a network: its organisation's folder, if it is not in the network's folder.",
)
@directory_option
@folder_option
@command_output
def install(
    node: str,
    certificate_file: Path,
    authority: Path | None,
    directory_file: Path | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Give a node the certificate that was issued for its request. A running node takes it within a second.

    It is refused, and the old one stays, if it is not for the node's key, its name and the addresses at which others
    reach it, or not of the authority that the network knows. Of a node that founds a network (node init --founding)
    the entry is signed then.

    Example: blockrobot certificate install node-7 node-7.crt.pem
    """
    config = get_node_config(node, folder)
    pem = read_public_text(certificate_file).encode()
    founding = read_founding_entry(config.data_dir)
    if founding is None:
        known = _directory(config, directory_file)
        made = check_certificate(config, pem, known, now_ms())
        check_fit(made, (config.name, *hosts_of(known.nodes[config.name])))
        install_certificate(config, made)
    else:
        home = authority or network_folder(folder) / "organisations" / founding.organisation
        founder = Founder(read_private_key(home / ADMIN_KEY_FILE), now_ms())
        trusted = read_authority_certificates(home / AUTHORITY_CERTIFICATE_FILE)
        made = certify_founder(config, founding, pem, trusted, founder)
    facts = read_facts(made)
    if as_json:
        print_answer(CertificateRenewAnswer(node=config.name, serial=facts.serial_hex, expires=facts.expires))
    else:
        console.print(f"{config.name} has certificate {facts.serial_hex} now; it counts until {facts.expires}.")
        if founding is not None:
            console.print(f"Its entry for the other founders: {escape(str(config.data_dir / NODE_ENTRY_FILE))}")


@certificate.command("renew")
@click.argument("node")
@click.option("--new-key", is_flag=True, help="Make a new key too: after a theft, or a revocation.")
@click.option(
    "--host",
    "hosts",
    multiple=True,
    help="An address that it names; may be repeated. Else those of the old one. Those in use have to be among them.",
)
@days_option
@authority_option
@directory_option
@folder_option
@command_output
def renew_certificate(
    node: str,
    new_key: bool,
    hosts: tuple[str, ...],
    days: int,
    authority: Path | None,
    directory_file: Path | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Renew a node's certificate in its data directory. A running node takes it within a second.

    It is refused, and the old one stays, if it does not name the addresses at which others reach the node, or is not of
    the authority that the network knows.

    Example: blockrobot certificate renew node-2 --days 365
    """
    config = get_node_config(node, folder)
    organisation = _organisation(config, folder)
    ca = get_authority(network_folder(folder), organisation, authority)
    known, entry = _known(config, directory_file)

    def check(made: x509.Certificate) -> None:
        if known is not None:
            identify_peer(made.public_bytes(Encoding.DER), known, now_ms())
        if entry is not None:
            check_fit(made, (config.name, *hosts_of(entry)))

    named = hosts or _own_hosts(config, entry)
    serial = renew(config, ca, days=days, new_key=new_key, hosts=named, check=check)
    report = read_report(config)
    expires = "" if report.facts is None else report.facts.expires
    if as_json:
        print_answer(CertificateRenewAnswer(node=config.name, serial=f"{serial:x}", expires=expires))
    else:
        console.print(f"{config.name} has certificate {serial:x} now; it counts until {expires}.")


@certificate.command()
@click.argument("node", required=False)
@click.option("--serial", help="The certificate by its serial number, in hexadecimal; else the one the node has now.")
@click.option("--certificate", "file", type=EXISTING_FILE, help="The certificate by its file (PEM).")
@click.option(
    "--of", "owner", metavar="ORG", help="With --serial or --certificate: whose authority issued it; else your own."
)
@governing_options
@command_output
def revoke(
    node: str | None, serial: str | None, file: Path | None, owner: str | None, admin: AdminOptions, as_json: bool
) -> None:
    """Revoke a certificate on the chain. An organisation revokes its own alone; another's needs a majority.

    Example: blockrobot certificate revoke node-2 --as hospital
    """
    if sum(item is not None for item in (node, serial, file)) != 1:
        raise click.UsageError("Name a node, or a certificate with --serial or --certificate.")
    if node is not None:
        config = get_node_config(node, admin.folder)
        facts = read_report(config).facts
        if facts is None:
            raise BlockRobotError("FILE_UNUSABLE", f"The certificate of {config.name} cannot be read; use --serial.")
        number, owner = facts.serial, owner or _organisation(config, admin.folder)
    else:
        number = parse_serial(str(serial) if file is None else f"{read_certificate(file).serial_number:x}")
    if admin.organisation is None and admin.key_file is None:
        admin = replace(admin, organisation=owner)
    signer = admin.signer()
    owner = owner or signer.name
    if not owner:
        raise click.UsageError("Say whose authority issued it: --of ORG.")
    arguments = {"organisation": owner, "serial": serial_bytes(number)}
    submitted = propose_once(signer, "membership", "revoke_certificate", arguments)
    report_decision(submitted, f"revoke certificate {number:x} of {owner}", "org", as_json=as_json)


def _directory(config: NodeConfig, file: Path | None) -> DirectoryContent:
    """Who is there, by a node's ledger or by a file that knows more."""
    genesis = load_genesis(config.genesis_path)
    known = newest_directory(genesis, [config])
    if file is None:
        return known
    given = decode_directory(read_given_file(file, JSON_MAX_BYTES), genesis.chain_id)
    return max(known, given, key=lambda content: content.height)


def _known(
    config: NodeConfig, file: Path | None = None
) -> tuple[DirectoryContent | None, NodeEntry | DirectoryNode | None]:
    """The directory, if it names a node already, and how that is entered: there, or for the founding of its network."""
    founding = read_founding_entry(config.data_dir)
    if founding is not None:
        return None, founding
    known = _directory(config, file)
    entry = known.nodes.get(config.name)
    return None if entry is None else known, entry


def _own_hosts(config: NodeConfig, entry: NodeEntry | DirectoryNode | None) -> tuple[str, ...]:
    return own_hosts(config, () if entry is None else hosts_of(entry))


def _organisation(config: NodeConfig, folder: Path | None) -> str:
    """Raises NOT_FOUND."""
    founding = read_founding_entry(config.data_dir)
    if founding is not None:
        return founding.organisation
    place = network_folder(folder)
    known = list(Cluster(place).configs.values()) if (place / "genesis.json").is_file() else []
    return organisation_of(config, [*known, config])
