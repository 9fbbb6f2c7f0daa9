"""Environments of servers that only the tests use: the user's, one for each set of pins and Python, shared by clones."""

from __future__ import annotations

import fcntl
import hashlib
import os
import subprocess
import sys
from pathlib import Path

USER_DATA = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
ENVIRONMENTS = USER_DATA / "blockrobot" / "test-servers"


def installed(name: str, requirements: Path, hint: str) -> Path:
    """Return the folder of the server's commands; installs the pinned requirements if they are not there yet.

    Raises RuntimeError, which ends with `hint`.
    """
    pins = [line for line in requirements.read_text().splitlines() if not line.startswith("#")]
    wanted = hashlib.sha256("\n".join([*pins, sys.version]).encode()).hexdigest()
    environment = ENVIRONMENTS / f"{name}-{wanted[:16]}"
    stamp = environment / "requirements.sha256"
    ENVIRONMENTS.mkdir(mode=0o700, parents=True, exist_ok=True)
    with (ENVIRONMENTS / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not stamp.exists() or stamp.read_text() != wanted:
            subprocess.run([sys.executable, "-m", "venv", "--clear", environment], check=True)
            pip = [environment / "bin" / "python", "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
            result = subprocess.run(
                [*pip, "--require-hashes", "--only-binary", ":all:", "--requirement", requirements],
                capture_output=True,
                text=True,
                check=False,
            )
            if result.returncode:
                raise RuntimeError(f"{name} cannot be installed for the tests. {hint}\n{result.stderr.strip()}")
            stamp.write_text(wanted)
    return environment / "bin"
