"""What a command was told of where nodes are: typed addresses, and the file of nodes beside a genesis file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

NODES_FILE = "nodes.json"
_TYPED_KEY = "blockrobot.typed_nodes"
_FILES_KEY = "blockrobot.nodes_files"
_SAID_KEY = "blockrobot.said_of_nodes"


def note_typed(context: click.Context, typed: Sequence[str]) -> None:
    context.meta[_TYPED_KEY] = tuple(typed)


def note_genesis_place(path: Path, chain_id: bytes) -> None:
    """Clients of this chain read the file of nodes beside its genesis file."""
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta.setdefault(_FILES_KEY, {})[chain_id] = path.with_name(NODES_FILE)


def told_nodes(chain_id: bytes) -> tuple[tuple[str, ...], Path | None]:
    """Typed addresses, and the file if there is one. Outside of commands there is nothing."""
    context = click.get_current_context(silent=True)
    if context is None:
        return (), None
    file = context.meta.get(_FILES_KEY, {}).get(chain_id)
    return context.meta.get(_TYPED_KEY, ()), file if file is not None and file.exists() else None


def say_once(words: str) -> None:
    """On standard error, once for each command: it may open several clients."""
    said: set[str] = click.get_current_context().meta.setdefault(_SAID_KEY, set())
    if words not in said:
        said.add(words)
        click.echo(words, err=True)
