"""The output folder of a run of experiments.

A non-empty folder is accepted only if it has our mark (locked while in use) and no foreign file; otherwise nothing is
removed.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from clients.sdk.new_files import open_to_append
from clients.sdk.pictures.picture_names import PICTURE_NAME
from consensus.errors import BlockRobotError
from network.cluster import Cluster
from network.experiments.definitions import EXPERIMENTS

MARK = ".blockrobot-experiments"
SUMMARY_FILE, REPORT_FILE = "summary.json", "report.html"
_RESULTS = (
    *("events.jsonl", "events.csv", "events.xes", "activities.csv", "pairs.csv"),
    *("process-map.dot", "process-map.svg", "process-map.png", SUMMARY_FILE, REPORT_FILE),
)
_PARTS = frozenset({*_RESULTS, "network", "wallets", "robots", "pictures"})
_NODE = r"network/nodes/node-\d+/"
_PART_FILES = re.compile(
    "|".join(
        (
            r"pictures/[a-z0-9-]+/[0-9a-f]{16,64}/" + PICTURE_NAME,
            r"pictures/[a-z0-9-]+/(?:[0-9a-f]{16,64}/|visit-[0-9a-f]{12}-)(?:contact-sheet\.png|animation\.gif)",
            r"wallets/[a-z0-9-]+\.(?:passphrase|wallet|words|uid)",
            r"wallets/\.(?:wallet-\w+|[a-z0-9-]+\.wallet\.lock)",
            r"robots/robot/(?:client\.pin|robot\.keys|robot\.lock|roster\.sealed|open-visits|\.tmp-open-visits)",
            r"robots/robot/\.client\.pin\.[0-9a-f]{8}",
            r"robots/robot/spool/(?:\.tmp-)?[\w.-]+\.clip",
            r"network/(?:genesis|cluster)\.(?:json|tmp)",
            r"network/organisations/[a-z0-9-]+/(?:(?:admin|registrar|ca\.key|ca\.crt)\.(?:key|pem)|client\.pin)",
            r"network/organisations/[a-z0-9-]+/(?:cards\.json|\.cards\.json\.tmp|organisation-entry\.json)",
            r"network/organisations/[a-z0-9-]+/\.client\.pin\.[0-9a-f]{8}",
            _NODE + r"(?:genesis\.json|directory\.json|node\.toml|operator(?:-read)?\.token|owner\.lock)",
            _NODE + r"(?:output\.log|node\.log(?:\.\d+)?|faults\.(?:json|tmp))",
            _NODE + r"custody/custody\.sqlite3(?:-wal|-shm|-journal|-swept)?",
            _NODE + r"erase-keys/erase-keys(?:\.new|\.tmp)?",
            _NODE + r"journal/votes\.journal(?:\.new)?",
            _NODE + r"keys/(?:(?:producer|custodian)\.key|tls\.(?:crt|key)\.pem)",
            _NODE + r"ledger/(?:data\.mdb|lock\.mdb|owner\.lock)",
        )
    )
)
"""What an experiment writes below its own files; anything else there is somebody's."""


@contextlib.contextmanager
def reserved_folder(out: Path) -> Iterator[None]:
    """For one run. Raises FOLDER_NOT_EMPTY if foreign or in use."""
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"{out} is a link or a file.")
    mark = out / MARK
    if out.exists() and any(out.iterdir()):
        _check(out)
    out.mkdir(parents=True, exist_ok=True)
    with open_to_append(mark) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BlockRobotError("FOLDER_NOT_EMPTY", f"Another run is at work in {out}.") from None
        yield


def _check(out: Path) -> None:
    """Raises FOLDER_NOT_EMPTY."""
    if not (out / MARK).is_file() or (out / MARK).is_symlink():
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"{out} is not empty and not of earlier experiments.")
    folders = {experiment.name for experiment in EXPERIMENTS}
    foreign = [item for item in out.iterdir() if item.name not in {MARK, SUMMARY_FILE, REPORT_FILE, *folders}]
    for name in folders:
        folder = out / name
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            foreign.append(folder)
        elif folder.exists():
            foreign += [item for item in folder.iterdir() if item.name not in _PARTS or item.is_symlink()]
            foreign += _foreign_below(folder)
    if foreign:
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"{foreign[0]} is not of an experiment: {out} is left as it is.")


def _foreign_below(folder: Path) -> list[Path]:
    found = []
    for place, folders, files in os.walk(folder):
        here = Path(place)
        found += [here / name for name in folders if here != folder and (here / name).is_symlink()]
        for path in (here / name for name in files if here != folder):
            ours = _PART_FILES.fullmatch(path.relative_to(folder).as_posix())
            if ours is None or path.is_symlink():
                found.append(path)
    return found


def make_experiment_folder(out: Path, name: str) -> Path:
    """Empty; an earlier run's remains are stopped and removed."""
    folder = out / name
    if folder.exists():
        stop_network(folder / "network")
        shutil.rmtree(folder)
    folder.mkdir()
    return folder


def stop_network(network: Path) -> None:
    if (network / "genesis.json").is_file():
        Cluster(network).stop_all()
