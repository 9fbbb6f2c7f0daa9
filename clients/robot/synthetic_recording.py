"""The recording that ships as a recipe: the published first run, rendered once on this machine and kept in a cache.

The tags' UIDs are drawn here and stand in a file readable by its user only, as a registrar's list of cards would.
"""

from __future__ import annotations

import json
import os
import secrets
from pathlib import Path

from clients.robot.bag import Progress, make_bag
from clients.robot.scenario import Scenario, published_run_1

_TAGS_FILE = "tags.json"
_UID_BYTES = 12  # an EPC-96


def load_or_draw_tags(folder: Path, scenario: Scenario) -> dict[str, str]:
    """Return alias -> UID (upper-case hexadecimal) of a scenario's tags, drawing them on first use."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    path = folder / _TAGS_FILE
    if path.exists():
        known: dict[str, str] = json.loads(path.read_text(encoding="utf-8"))
        if all(alias in known for alias in scenario.tagged_aliases):
            return known
    drawn = {alias: secrets.token_hex(_UID_BYTES).upper() for alias in scenario.tagged_aliases}
    temporary = path.with_suffix(".tmp")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        json.dump(drawn, file)
    temporary.replace(path)
    return drawn


def default_recording(home: Path, progress: Progress | None = None) -> Path:
    """Return the bag of the published first run, rendering it if this user has none yet (about a minute)."""
    scenario = published_run_1()
    folder = home / "recordings"
    return make_bag(scenario, load_or_draw_tags(folder, scenario), folder, progress=progress)
