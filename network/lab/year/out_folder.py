"""What a hospital's year leaves in its folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from clients.sdk.new_files import replace_file
from network.lab.year.figures import HospitalYearAnswer
from network.lab.year.year_page import build_page
from network.provisioning.network_files import HALF_DONE
from network.run_folder import STAGE_FILES, empty, reserved_folder

NETWORK, SNAPSHOT, BACKUP, RESTORED = "network", "snapshot", "backup", "restored"
REPORT_FILE, FIGURES_FILE = "report.html", "figures.json"
MARK = ".blockrobot-year"
_COPIES = rf"\.?(?:{SNAPSHOT}|{BACKUP}|{RESTORED})(?:\.[a-z0-9_]+)*/.+|\.[a-z0-9-]+\.{HALF_DONE}/.+"


@contextmanager
def reserved_out(out: Path) -> Iterator[None]:
    """Empty; what an earlier year left there is removed. Raises FOLDER_NOT_EMPTY if foreign or in use."""
    with reserved_folder(out, MARK, rf"report\.html|figures\.json|{STAGE_FILES}|{_COPIES}"):
        empty(out, MARK)
        yield


def write_results(out: Path, answer: HospitalYearAnswer) -> None:
    replace_file(out / FIGURES_FILE, msgspec.json.format(msgspec.json.encode(answer)) + b"\n", 0o644)
    replace_file(out / REPORT_FILE, build_page(answer).encode(), 0o644)
