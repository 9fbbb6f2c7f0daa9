"""`blockrobot explore`: a node's explorer in the browser, from a page of this machine.

The browser gets a session with the command alone, at an origin that nothing had before: at the node's own address
somebody may have left a service worker.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import click
import msgspec
from aiohttp import web

from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient, open_pinned_client
from clients.sdk.node_answers import failure_of
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FILE, command_output, console, home_folder, print_answer, status_line
from clients.sdk.trust_pin import PIN_FILE
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_answers import ExploreAnswer
from network.cli.cluster.cluster_options import folder_option
from network.cli.contract.contract_signers import get_signers
from network.cli.governance.governance_signer import Signer
from network.console.serving import show_until_stopped
from node.explorer.page import own_files
from pages.local_page import LINK_LIFETIME_MS, LocalPage, LocalRoute, Opened, read_object
from pages.opening import open_in_browser

LINKS_FOLDER = "links"
TITLE = "the BlockRobot explorer"
_REFUSED = frozenset({"SESSION_REFUSED", "NOT_PERMITTED"})


@dataclass(frozen=True, slots=True)
class ExplorerAccess:
    """A node, and the member that it answers."""

    node: NodeAddress
    signer: Signer


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
    asyncio.run(_explore(signers, node_name, no_browser=no_browser, as_json=as_json))


async def _explore(signers: list[Signer], node_name: str | None, *, no_browser: bool, as_json: bool) -> None:
    with status_line("Asking a node for a session ...", as_json=as_json):
        access = await open_explorer(signers, node_name)

    def opened(page: Opened) -> None:
        is_shown = not no_browser and not as_json and open_in_browser(page.redirect_file)
        if as_json:
            answer = ExploreAnswer(
                node=access.node.name,
                as_=access.signer.name,
                redirect_file=str(page.redirect_file),
                valid_s=LINK_LIFETIME_MS // 1000,
            )
            print_answer(answer)
            return
        name, who = escape(access.node.name), escape(access.signer.name)
        console.print(f"The explorer of {name}, as {who}: what you see is what this one node says.")
        console.print("It is open in your browser." if is_shown else "Open this file in your browser:")
        if not is_shown:
            console.print(page.redirect_file.resolve().as_uri(), markup=False)
        console.print("It opens once, within two minutes. Enter: another link. Ctrl-C: end the explorer.")

    async with explorer_page(access, home_folder() / LINKS_FOLDER) as page:
        await show_until_stopped(page, opened, is_interactive=not as_json)


@asynccontextmanager
async def explorer_page(access: ExplorerAccess, redirect_folder: Path) -> AsyncIterator[LocalPage]:
    """Unstarted; reads in the member's name and takes no transaction. Stop it in the end."""
    async with NetworkClient(access.signer.genesis) as client:

        async def pass_on(request: web.Request) -> web.Response:
            path = request.rel_url.raw_path.removeprefix("/api")
            body = msgspec.json.encode(await read_object(request)) if request.method == "POST" else None
            content = await client.ask_node(
                access.node, request.method, path, key=access.signer.key, body=body, query=request.query
            )
            return web.Response(body=content, content_type="application/json")

        routes = [
            LocalRoute("GET", "/api/v1/{path:.+}", pass_on),
            LocalRoute("POST", "/api/v1/queries", pass_on),
        ]
        page = LocalPage(
            own_files(), routes, redirect_folder=redirect_folder, title=TITLE, command="blockrobot explore"
        )
        try:
            yield page
        finally:
            await page.stop()


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
    failures = []
    for node in nodes:
        try:
            return await _enter(client, signer, node)
        except BlockRobotError as error:
            failures.append(error)
    raise failure_of(failures)


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
    return ExplorerAccess(node, signer)
