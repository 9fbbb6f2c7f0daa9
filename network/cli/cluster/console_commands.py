"""`blockrobot console` and `up --console`: the page of a local network."""

from __future__ import annotations

import asyncio
from pathlib import Path

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, home_folder, print_answer
from clients.sdk.terminal.terminal import console as terminal
from network.cli.cluster.cluster_answers import ConsoleAnswer
from network.cli.cluster.cluster_options import dir_words, folder_option, network_folder
from network.cluster import Cluster
from pages.local_page import Opened
from pages.opening import open_in_browser

no_browser_option = click.option("--no-browser", is_flag=True, help="Open no browser; say which file opens the page.")


@click.command()
@folder_option
@no_browser_option
@command_output
def console(folder: Path | None, no_browser: bool, as_json: bool) -> None:
    """Show a local network in the browser: who leads and votes, what flows, buttons for every fault, a time line.

    It records while it runs; "Export" writes the run as one HTML file that replays it. Ctrl-C ends the console, not
    the network. The link opens the page once, for this user alone; Enter makes another.

    Example: blockrobot console
    """
    show_console(Cluster(network_folder(folder)), no_browser=no_browser, as_json=as_json)


def show_console(cluster: Cluster, *, no_browser: bool, as_json: bool) -> None:
    from network.console.serving import serve_console  # noqa: PLC0415 - only when it is needed

    def opened(page: Opened) -> None:
        is_shown = not no_browser and not as_json and open_in_browser(page.redirect_file)
        if as_json:
            print_answer(ConsoleAnswer(url=page.url, open=str(page.redirect_file)))
            return
        terminal.print("The console is open in your browser." if is_shown else "Open this file in your browser:")
        if not is_shown:
            terminal.print(f"  {escape(page.redirect_file.resolve().as_uri())}")
        terminal.print("It opens once. Enter: another link. Ctrl-C: end the console; the network goes on.")

    folder = home_folder() / "console"
    asyncio.run(serve_console(cluster, redirect_folder=folder, opened=opened, is_interactive=not as_json))
    if not as_json:
        step = f"blockrobot status{dir_words(cluster.folder)}"
        terminal.print(escape(f"The console has ended; the network goes on. See {step}."))
