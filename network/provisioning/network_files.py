"""What a network's programs write below its folder. Whatever else lies there is somebody's, and is never deleted."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from consensus.errors import BlockRobotError

_ORGANISATION = r"organisations/(?:\.[a-z0-9-]+\.[a-z0-9_]{8}/)?[a-z0-9-]+/"
_NODE = r"nodes/(?:\.[a-z0-9-]+\.[a-z0-9_]{8}/)?[a-z0-9-]+/"
_UNFINISHED = r"\.unfinished-[0-9a-f]{16}"
HALF_DONE = "halfdone"
_PIN = r"(?:client\.pin|\.client\.pin\.[0-9a-f]{8})"
NETWORK_FILES = "|".join(
    (
        r"(?:genesis|cluster)\.(?:json|tmp)|\.blockrobot-making|" + _PIN,
        _ORGANISATION + r"(?:(?:admin|registrar|ca\.key|ca\.crt)\.(?:key|pem)|organisation-entry\.json)",
        _ORGANISATION + r"(?:cards\.json|\.cards\.json\.tmp|" + _PIN + ")",
        _NODE + r"(?:node\.toml|genesis\.json|directory\.json|node-entry\.json|operator(?:-read)?\.token|owner\.lock)",
        _NODE + r"(?:output\.log|node\.log(?:\.\d+)?|faults\.(?:json|tmp)|prune\.(?:request|tmp))",
        r"nodes/\.[a-z0-9-]+\." + HALF_DONE + r"/owner\.lock",
        _NODE + r"(?:node\.csr|node-entry\.draft\.json|node\.toml\.(?:moving|copying)|" + _UNFINISHED + ")",
        _NODE + r"custody(?:\.mov(?:ed|ing))?/custody\.sqlite3(?:-wal|-shm|-journal|-swept)?",
        _NODE + r"custody(?:\.mov(?:ed|ing))?/(?:clips\.json|" + _UNFINISHED + ")",
        _NODE + r"clips/(?:custodian|(?:[0-9a-f]{2}/){2}(?:[0-9a-f]{60}-[0-9a-f]{16}|" + _UNFINISHED + "))",
        _NODE + r"clips/" + _UNFINISHED,
        _NODE + r"erase-keys/erase-keys(?:\.new|\.tmp)?",
        _NODE + r"journal/votes\.journal(?:\.new|\.damaged)?",
        _NODE + r"keys/(?:(?:producer|custodian)\.key|tls\.(?:crt|key)\.pem(?:\.new)?)",
        _NODE + r"ledger(?:\.incoming|\.replaced)?/(?:data\.mdb|lock\.mdb|owner\.lock|restored\.whole)",
        _NODE + r"snapshots(?:\.fetched)?/(?:\.\d{12}\.[a-z0-9_]{8}/)?[0-9a-f]+/(?:manifest|chunk-\d{6})",
    )
)
"""An expression for their paths from the network's folder."""
_NETWORK_FILE = re.compile(NETWORK_FILES)


def find_foreign(folder: Path, own: re.Pattern[str] = _NETWORK_FILE) -> Iterator[Path]:
    """Links, and files whose path from here is not `own`. Raises OSError where it may not look."""
    for place, folders, files in os.walk(folder, onerror=_raise):
        here = Path(place)
        yield from (here / name for name in folders if (here / name).is_symlink())
        for path in (here / name for name in files):
            if path.is_symlink() or own.fullmatch(path.relative_to(folder).as_posix()) is None:
                yield path


def _raise(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError):  # a node that runs may remove a folder meanwhile
        raise error


def require_own(folder: Path, own: re.Pattern[str] = _NETWORK_FILE) -> None:
    """Before it is emptied. Raises FOLDER_NOT_EMPTY, OSError."""
    for path in find_foreign(folder, own):
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"{path} was not made by this command: nothing was deleted.")


def remove_marked(folder: Path, mark: str) -> None:
    """The mark last: what a cut leaves is still known for what it is. Raises OSError."""
    for place in folder.iterdir():
        if place.is_dir() and not place.is_symlink():
            shutil.rmtree(place)
        elif place.name != mark:
            place.unlink()
    (folder / mark).unlink(missing_ok=True)
    folder.rmdir()
