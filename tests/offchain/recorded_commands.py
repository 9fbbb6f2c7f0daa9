"""The commands that a MongoDB store sends, as the driver tells of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import pytest
from pymongo import AsyncMongoClient
from pymongo.monitoring import CommandFailedEvent, CommandListener, CommandStartedEvent, CommandSucceededEvent

from node.custody.stores import mongo_store
from node.custody.stores.mongo_documents import Document


@dataclass(slots=True)
class Command:
    """One command, the collection that it names (none: a transaction's end), and what it looks for."""

    kind: str
    collection: str
    filters: list[Document]
    took_ms: float = 0.0


class Commands(CommandListener):
    """All commands in their order."""

    def __init__(self) -> None:
        self.sent: list[Command] = []
        self._open: dict[int, Command] = {}

    def started(self, event: CommandStartedEvent) -> None:
        body: Any = event.command
        filters = [part["q"] for part in (*body.get("updates", ()), *body.get("deletes", ()))]
        filters += [body["filter"]] if "filter" in body else [part["$match"] for part in body.get("pipeline", [])[:1]]
        name = body[event.command_name]
        command = Command(event.command_name, name if isinstance(name, str) else "", filters)
        self._open[event.request_id] = command
        self.sent.append(command)

    def succeeded(self, event: CommandSucceededEvent) -> None:
        self._open.pop(event.request_id).took_ms = event.duration_micros / 1000

    def failed(self, event: CommandFailedEvent) -> None:
        del self._open[event.request_id]


@contextmanager
def recorded_commands() -> Iterator[Commands]:
    """Of each store that is opened meanwhile."""
    commands = Commands()
    with pytest.MonkeyPatch.context() as patches:
        patches.setattr(mongo_store, "AsyncMongoClient", partial(AsyncMongoClient, event_listeners=[commands]))
        yield commands
