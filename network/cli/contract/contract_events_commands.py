"""`blockrobot contract events`: contract events in order, each once.

Restarts miss and repeat nothing: the position is replaced only after output is written.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path

import click
import msgspec

from clients.sdk.chain.contract_events import EventPage, FoundEvent, Place, read_events, read_place
from clients.sdk.network_client import NetworkClient
from clients.sdk.new_files import SMALL_FILE_MAX_BYTES, open_to_append, read_given_file, replace_file, require_free
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FILE, command_output, console
from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state.lifecycle import MACHINE_TABLE
from contracts.kit.arguments import format_value
from network.cli.contract.contract_answers import ContractEventAnswer
from network.cli.contract.contract_signers import FindSigners, signer_options
from network.cli.governance.governance_signer import read_with_first, to_json

WAIT_MS = 10_000
RETRY_S = 1.0
PAUSE_S = 0.1
BEGINNING = "start"
NOW = "now"
EVENT_BEGINS = b'{"place": "'


@dataclass(frozen=True, slots=True)
class EventFilter:
    """Event filter: contract, name or all, on one chain."""

    chain: str
    contract: str | None
    name: str | None

    def memory(self, place: Place) -> bytes:
        fields = {"chain": self.chain, "contract": self.contract, "name": self.name, "next": str(place)}
        return json.dumps(fields).encode() + b"\n"

    def remembered(self, path: Path) -> Place | None:
        """The position in a state file. Raises EVENTS_STATE_OF_OTHERS, EVENTS_STATE_BROKEN, FILE_EXISTS for a link."""
        require_free(path, replace=True)
        try:
            fields = read_json_text(read_given_file(path, SMALL_FILE_MAX_BYTES))
            place = read_place(fields["next"])
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError, BlockRobotError):
            raise BlockRobotError("EVENTS_STATE_BROKEN", f"{path} is no state file of this command.") from None
        its = EventFilter(fields.get("chain"), fields.get("contract"), fields.get("name"))
        if its != self:
            chain = "" if its.chain == self.chain else " of another network"
            text = f"{path} remembers a place among {its.words()}{chain}, and you ask for {self.words()}."
            raise BlockRobotError("EVENTS_STATE_OF_OTHERS", text)
        return place

    def words(self) -> str:
        which = "all events" if self.name is None else f"the events {self.name}"
        return which if self.contract is None else f"{which} of the contract {self.contract}"


def _line(event: FoundEvent) -> str:
    answer = ContractEventAnswer(
        place=str(event.place),
        contract=event.contract,
        name=event.name,
        data=to_json(event.data),
        txid=event.txid.hex(),
    )
    return json.dumps(msgspec.to_builtins(answer, builtin_types=(bytes,)), ensure_ascii=False)


def last_written(path: Path) -> Place | None:
    """After the last whole line; a partial line is cut off. Raises EVENTS_FILE_FOREIGN for a foreign file."""
    if not path.exists():
        return None
    with open_to_append(path) as file:
        file.seek(0)
        content = file.read()
        whole = content[: content.rfind(b"\n") + 1]
        place = _place_of_last(path, whole)
        rest = content[len(whole) :]
        if not rest.startswith(EVENT_BEGINS[: len(rest)]):
            raise BlockRobotError("EVENTS_FILE_FOREIGN", f"The last line of {path} is no event.")
        if rest:
            file.truncate(len(whole))
    return place


def _place_of_last(path: Path, whole: bytes) -> Place | None:
    if not whole:
        return None
    try:
        place = read_place(read_json_text(whole[whole.rfind(b"\n", 0, -1) + 1 :])["place"])
    except (ValueError, KeyError, TypeError, BlockRobotError):
        raise BlockRobotError("EVENTS_FILE_FOREIGN", f"The last line of {path} is no event.") from None
    return Place(place.height, place.index + 1)


def _append(path: Path, events: tuple[FoundEvent, ...]) -> None:
    if not events:
        return
    text = "".join(_line(event) + "\n" for event in events)
    with open_to_append(path) as file:
        file.write(text.encode())
        file.flush()
        os.fsync(file.fileno())


def _show(event: FoundEvent, *, as_json: bool) -> None:
    if as_json:
        click.echo(_line(event))
    else:
        console.print(escape(f"{event.place}  {event.contract}.{event.name} {format_value(event.data)}"))


@contextlib.asynccontextmanager
async def _stopped_by_signals() -> AsyncIterator[None]:
    """SIGINT and SIGTERM cancel between two pages: a clean end."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, task.cancel)
    try:
        yield
    except asyncio.CancelledError:
        task.uncancel()
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)


async def _first_place(client: NetworkClient, key: PrivateKey, text: str) -> Place | None:
    if text == BEGINNING:
        return None
    if text == NOW:
        return Place((await client.newest_header(key)).height + 1, 0)
    return read_place(text)


async def follow(
    client: NetworkClient,
    key: PrivateKey,
    wanted: EventFilter,
    first: Place | None,
    take: Callable[[EventPage], None],
    *,
    forever: bool,
) -> None:
    """Pass every page to `take`; end at the newest block unless `forever`, which retries unreachable nodes. Raises
    permanent errors such as BLOCK_PRUNED.
    """
    place, silent = first, False
    while True:
        try:
            page = await read_events(
                client, key, place, contract=wanted.contract, name=wanted.name, wait_ms=WAIT_MS if forever else 0
            )
        except BlockRobotError as error:
            if not forever or not error.entry.retryable:
                raise
            if not silent:
                click.echo(f"{error.detail} Still asking.", err=True)
            silent = True
            await asyncio.sleep(RETRY_S)
            continue
        silent = False
        take(page)
        if page.next == place:
            await asyncio.sleep(PAUSE_S)
        place = page.next
        if not forever and place.height > page.head:
            return


async def _warn_of_unknown(client: NetworkClient, key: PrivateKey, contract: str | None) -> None:
    if contract is None:
        return
    try:
        table = (await client.state_values([MACHINE_TABLE.flat], key)).values[MACHINE_TABLE.flat] or {}
    except BlockRobotError:
        return  # Whoever may not read the state, or meets no node, is told so by what follows, or needs no warning.
    if contract not in table:
        click.echo(f"The chain has no contract {contract!r} (see `blockrobot contract list`).", err=True)


def _check_place(_context: click.Context, _parameter: click.Parameter, text: str) -> str:
    try:
        if text not in {BEGINNING, NOW}:
            read_place(text)
    except BlockRobotError as error:
        raise click.BadParameter(error.detail) from None
    return text


@click.command()
@click.option("--follow", "forever", is_flag=True, help="Go on until stopped, also while nodes are away.")
@click.option("--contract", metavar="NAME", help="Only events of this contract.")
@click.option("--name", metavar="EVENT", help="Only events of this name.")
@click.option(
    "--from",
    "first",
    default=BEGINNING,
    show_default=True,
    callback=_check_place,
    help="start (the oldest kept), now, or a place height:index.",
)
@click.option("--state", type=FILE, help="Remember here where to go on; go on there.")
@click.option("--out", type=FILE, help="Append to this file, one JSON object a line; go on there.")
@signer_options
@command_output
def events(
    forever: bool,
    contract: str | None,
    name: str | None,
    first: str,
    state: Path | None,
    out: Path | None,
    find: FindSigners,
    as_json: bool,
) -> None:
    """Show the events of contracts in order; each comes once, with its place. With --json one object a line.

    With --state or --out it goes on where it stopped, whichever node then answers.

    Example: blockrobot contract events --follow --contract settings --state settings.cursor --as hospital
    """
    if state is not None and out is not None:
        raise click.UsageError("Either --state or --out: the file of --out is its own memory.")
    signers = find()
    wanted = EventFilter(signers[0].genesis.chain_id.hex(), contract, name)
    remembered = wanted.remembered(state) if state is not None else None if out is None else last_written(out)
    written = remembered

    def take(page: EventPage) -> None:
        nonlocal written
        if page.next.height > page.head + 1 and page.next != written:
            click.echo(f"The place {page.next} is not there yet: the newest block is {page.head}.", err=True)
        if out is not None:
            _append(out, page.events)
        else:
            for event in page.events:
                _show(event, as_json=as_json)
            sys.stdout.flush()
        if state is not None and page.next != written:
            replace_file(state, wanted.memory(page.next))
        written = page.next

    async def read(client: NetworkClient, key: PrivateKey) -> None:
        async with _stopped_by_signals():
            await _warn_of_unknown(client, key, contract)
            place = written if written is not None else await _first_place(client, key, first)
            await follow(client, key, wanted, place, take, forever=forever)

    read_with_first(signers, read)
