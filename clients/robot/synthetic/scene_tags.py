"""Tags of synthetic scenes, drawn once per machine, in a file private to its user."""

from __future__ import annotations

import json
import os
import secrets
from pathlib import Path

from clients.robot.synthetic.scenario import Scenario
from consensus.bounded_text import read_json_text

_TAGS_FILE = "tags.json"
_UID_BYTES = 12  # an EPC-96


def load_or_draw_tags(folder: Path, scenario: Scenario) -> dict[str, str]:
    """Return alias -> UID (upper-case hex), drawing missing ones."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    path = folder / _TAGS_FILE
    known: dict[str, str] = read_json_text(path.read_text(encoding="utf-8")) if path.exists() else {}
    new = [alias for alias in scenario.tagged_aliases if alias not in known]
    if not new:
        return known
    drawn = {**known, **{alias: secrets.token_hex(_UID_BYTES).upper() for alias in new}}
    temporary = path.with_suffix(".tmp")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        json.dump(drawn, file)
    temporary.replace(path)
    return drawn
