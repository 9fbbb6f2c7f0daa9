"""The output folder of a run of experiments, which has a folder for each."""

from __future__ import annotations

import contextlib
from pathlib import Path

from network.experiments.definitions import EXPERIMENTS
from network.run_folder import STAGE_FILES, empty, reserved_folder

MARK = ".blockrobot-experiments"
SUMMARY_FILE, REPORT_FILE = "summary.json", "report.html"
_PAGES = r"summary\.json|report\.html"
_RESULTS = _PAGES + r"|events\.(?:jsonl|csv|xes)|(?:activities|pairs)\.csv|process-map\.(?:dot|svg|png)"
_FOLDERS = "|".join(experiment.name for experiment in EXPERIMENTS)


def reserved_out(out: Path) -> contextlib.AbstractContextManager[None]:
    """Raises FOLDER_NOT_EMPTY if foreign or in use."""
    return reserved_folder(out, MARK, rf"{_PAGES}|(?:{_FOLDERS})/(?:{_RESULTS}|{STAGE_FILES})")


def make_experiment_folder(out: Path, name: str) -> Path:
    """Empty; an earlier run's remains are stopped and removed."""
    folder = out / name
    folder.mkdir(exist_ok=True)
    empty(folder)
    return folder
