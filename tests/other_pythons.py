"""Finds the Pythons of this machine that BlockRobot supports: on the path, and those that pyenv keeps."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

SUPPORTED_MINORS = range(11, 15)
ASK = "import sys; print('%d.%d' % sys.version_info[:2])"


def find_pythons() -> dict[str, Path]:
    """Return one interpreter for each supported version that answers, by version: `3.12` and so on."""
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"
    found: dict[str, Path] = {}
    for version in (f"3.{minor}" for minor in SUPPORTED_MINORS):
        on_path = shutil.which(f"python{version}")
        kept = sorted(pyenv.glob(f"{version}.*/bin/python{version}"))
        for place in [*([Path(on_path)] if on_path else []), *kept]:
            told = subprocess.run([place, "-c", ASK], capture_output=True, text=True, check=False, timeout=60)
            if told.returncode == 0 and told.stdout.strip() == version:
                found[version] = place
                break
    return found
