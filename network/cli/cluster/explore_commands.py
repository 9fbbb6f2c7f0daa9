"""`blockrobot explore`: a node's explorer in the browser.

The page gets a signed challenge answer, valid once within a minute, through an owner-only file and the address fragment:
unseen by servers, proxies and process lists.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from dataclasses import dataclass
from pathlib import Path

import click
import msgspec

from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient, open_pinned_client
from clients.sdk.node_answers import read_answer, read_hex
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FILE, command_output, console, home_folder, print_answer, status_line
from clients.sdk.trust_pin import PIN_FILE
from consensus.api_documents import ChallengeAnswer, ChallengeRequest
from consensus.chain.session_message import sign_session
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_answers import ExploreAnswer
from network.cli.cluster.cluster_options import folder_option
from network.cli.contract.contract_signers import get_signers
from network.cli.governance.governance_signer import Signer
from pages.local_page import write_redirect
from pages.opening import open_in_browser

LINKS_FOLDER = "links"
LINK_LIFETIME_S = 60
TITLE = "the BlockRobot explorer"
_REFUSED = frozenset({"SESSION_REFUSED", "NOT_PERMITTED"})


@dataclass(frozen=True, slots=True)
class ExplorerAccess:
    """A node's explorer, its viewer and the one-time address."""

    node: NodeAddress
    signer: Signer
    target: str


@click.command()
@click.option(
    "--node", "node_name", metavar="NAME", help="Which node to look through (default: the first that answers)."
)
@click.option(
    "--profile", "--wallet", "wallet_profile", metavar="PROFILE", help="Look as the person whose wallet this is."
)
@click.option("--as", "officer", metavar="ORG[/ROLE]", help="Look as an organisation's admin, or ORG/registrar.")
@click.option("--key", "key_file", type=FILE, help="Look with a key file of raw 32 bytes.")
@click.option("--no-browser", is_flag=True, help="Open nothing: print the file to open.")
@folder_option
@command_output
def explore(
    node_name: str | None,
    wallet_profile: str | None,
    officer: str | None,
    key_file: Path | None,
    no_browser: bool,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Open a node's explorer in the browser, in your own session: blocks, votes, transactions, contracts, receipts.

    Without a name it looks as the first organisation's admin whose key is in the network's folder.

    Example: blockrobot explore --node node-2
    """
    signers = get_signers(folder, officer, key_file, wallet_profile)
    with status_line("Asking a node for a session ...", as_json=as_json):
        entrance = asyncio.run(open_explorer(signers, node_name))
    file = keep_link(home_folder() / LINKS_FOLDER, entrance.target)
    opened = not no_browser and not as_json and open_in_browser(file)
    if as_json:
        answer = ExploreAnswer(
            node=entrance.node.name, as_=entrance.signer.name, redirect_file=str(file), valid_s=LINK_LIFETIME_S
        )
        print_answer(answer)
        return
    name, who = escape(entrance.node.name), escape(entrance.signer.name)
    console.print(f"The explorer of {name}, as {who}: what you see is what this one node says.")
    if opened:
        console.print("It opens in your browser. If it does not, open this file there within a minute; it works once:")
    else:
        console.print("Open this file in a browser within a minute; it works once:")
    console.print(file.resolve().as_uri(), markup=False)


async def open_explorer(signers: list[Signer], node_name: str | None) -> ExplorerAccess:
    """For the first admitted signer. Raises SESSION_REFUSED, NODE_UNREACHABLE, or NOT_FOUND for an unknown node."""
    async with open_pinned_client(signers[0].genesis, signers[0].folder / PIN_FILE) as client:
        refusal: BlockRobotError | None = None
        for signer in signers:
            try:
                return await _enter_any(client, signer, node_name)
            except BlockRobotError as error:
                if error.code not in _REFUSED:
                    raise
                refusal = refusal or error
    raise refusal or BlockRobotError("SESSION_REFUSED")


async def _enter_any(client: NetworkClient, signer: Signer, node_name: str | None) -> ExplorerAccess:
    nodes = await _nodes_of(client, signer, node_name)
    failure: BlockRobotError | None = None
    for node in nodes:
        try:
            return await _enter(client, signer, node)
        except BlockRobotError as error:
            if not error.entry.retryable:
                raise
            failure = failure or error
    raise failure or BlockRobotError("NODE_UNREACHABLE")


async def _nodes_of(client: NetworkClient, signer: Signer, node_name: str | None) -> tuple[NodeAddress, ...]:
    if node_name is None:
        return client.nodes
    if node_name not in {node.name for node in client.nodes}:
        await client.find_nodes(signer.key)  # it may have joined later
    named = tuple(node for node in client.nodes if node.name == node_name)
    if not named:
        known = ", ".join(node.name for node in client.nodes)
        raise BlockRobotError("NOT_FOUND", f"This network has no node {node_name!r}; it has {known}.")
    return named


async def _enter(client: NetworkClient, signer: Signer, node: NodeAddress) -> ExplorerAccess:
    await client.ask_node(node, "GET", "/v1/explorer/status", key=signer.key)
    key = signer.key.public_key
    body = msgspec.json.encode(ChallengeRequest(key.hex()))
    content = await client.ask_node(node, "POST", "/v1/session-challenges", lane=key, body=body)
    challenge = read_hex(read_answer(content, ChallengeAnswer).challenge)
    signature = sign_session(signer.key, signer.genesis.chain_id, node.name, challenge)
    answer = f"{key.hex()}.{challenge.hex()}.{signature.hex()}"
    return ExplorerAccess(node, signer, f"{node.url}/explorer/#in={answer}")


def keep_link(folder: Path, target: str) -> Path:
    """Owner-only; expired files are removed."""
    if folder.is_dir():
        for old in folder.glob("open-*.html"):
            with contextlib.suppress(FileNotFoundError):  # another command tidies up too
                if time.time() - old.stat().st_mtime > LINK_LIFETIME_S:
                    old.unlink()
    return write_redirect(folder, target, TITLE)
