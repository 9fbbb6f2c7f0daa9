"""What a shell completes: profiles, and records that were viewed here.

A wallet's file is sealed, and nothing is written beside it for a shell to read: a list of record ids in the clear would
say who was recorded. What completes are the folders that `view` wrote, because the person wanted those.
"""

from __future__ import annotations

import re
from pathlib import Path

import click

from clients.sdk.terminal.terminal import home_folder

_RECORD = re.compile(r"[0-9a-f]{32}")
SHOWN_CHARS = 12


def complete_profiles(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    """Return the names of wallets in the folder of wallets that begin so."""
    folder = ctx.params.get("wallet_dir") or home_folder() / "wallets"
    try:
        names = sorted(path.stem for path in Path(folder).glob("*.wallet"))
    except OSError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def complete_records(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    """Return the beginnings of ids of records that were written below `--out` (`pictures`)."""
    folder = Path(ctx.params.get("out") or "pictures")
    try:
        names = sorted(path.name for path in folder.iterdir() if _RECORD.fullmatch(path.name) and path.is_dir())
    except OSError:
        return []
    found = [name for name in names if name.startswith(incomplete.lower())]
    return [name if len(incomplete) > SHOWN_CHARS else name[:SHOWN_CHARS] for name in found]
