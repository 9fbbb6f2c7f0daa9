"""Makes docs/pictures/page/guardian-sheet-*.png: the first of three sheets that the wallet's own commands wrote.

The wallet is made for the picture and deleted after it, on no network; one sheet of three alone opens nothing. Must never
retouch a picture, and never show a second sheet of the same set. Run it from the root of the repository:
.venv/bin/python -m tests.ui.picture_guardian_sheet
"""

from __future__ import annotations

import asyncio
import json
import secrets
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.ui.picture_reports import take_from_disk

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "page"
COMMAND_MAX_S = 60
SHEET_HEIGHT_MAX_PX = 1_400  # all of it on a wide screen, as on paper
GUARDIANS = ("Ann", "Ben", "Cleo")


def tell_wallet(home: Path, *arguments: str) -> Any:
    """Run a command of the wallet in a folder of its own; return what it answers."""
    passphrase = home / "passphrase"
    settings = {"BLOCKROBOT_HOME": str(home), "BLOCKROBOT_PASSPHRASE_FILE": str(passphrase), "PATH": "/usr/bin:/bin"}
    command = [sys.executable, "-m", "network.cli.main", "wallet", "--language", "en", *arguments, "--json"]
    ran = subprocess.run(command, env=settings, capture_output=True, check=True, timeout=COMMAND_MAX_S)
    return json.loads(ran.stdout)


def write_a_sheet(home: Path) -> Path:
    """Make a wallet and its guardians' sheets as a person would; return where the first sheet is."""
    passphrase = home / "passphrase"
    passphrase.touch(mode=0o600)
    passphrase.write_text(secrets.token_hex(), encoding="utf-8")
    tell_wallet(home, "new", "--words-file", str(home / "words"))
    named = [word for name in GUARDIANS for word in ("--guardian", name)]
    made = tell_wallet(home, "guardians", "split", *named, "--out", str(home / "sheets"), "--yes")
    return Path(made["sheets"][0])


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        asyncio.run(take_from_disk({"guardian-sheet": write_a_sheet(Path(place))}, FOLDER, SHEET_HEIGHT_MAX_PX))
