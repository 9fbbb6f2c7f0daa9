"""Shell completion of profiles and viewed records. Only folders written by `view` are listed; no plaintext record list
is kept.
"""

from __future__ import annotations

import re
from pathlib import Path

import click

from clients.sdk.terminal.terminal import home_folder

_RECORD = re.compile(r"[0-9a-f]{32}")
SHOWN_CHARS = 12


def complete_profiles(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    folder = ctx.params.get("wallet_dir") or home_folder() / "wallets"
    try:
        names = sorted(path.stem for path in Path(folder).glob("*.wallet"))
    except OSError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def complete_records(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    """Return id prefixes of records written below `--out` (`pictures`)."""
    folder = Path(ctx.params.get("out") or "pictures")
    try:
        names = sorted(path.name for path in folder.iterdir() if _RECORD.fullmatch(path.name) and path.is_dir())
    except OSError:
        return []
    found = [name for name in names if name.startswith(incomplete.lower())]
    return [name if len(incomplete) > SHOWN_CHARS else name[:SHOWN_CHARS] for name in found]
