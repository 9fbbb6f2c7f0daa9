"""rclpy for the tests: wheels of ROS 2 in an environment of their own, as sourcing a distribution gives it to a user.

The environment is the user's, one for each set of pins and Python, so that clones of the project share it. Installing fails
loudly. Run by `make test` before the tests, to say what is missing before anything else runs.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import subprocess
import sys
from pathlib import Path

from tests.robot_live.own_network import WAY_OUT, NoOwnNetworkError, nothing, run_in_own_network

ROOT = Path(__file__).resolve().parents[2]
USER_DATA = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
ENVIRONMENTS = USER_DATA / "blockrobot" / "test-servers"
REQUIREMENTS = ROOT / "tests" / "requirements-ros2.txt"
WORKSPACE = ROOT / "tests" / "robot_live" / "ros2_workspace"
"""What a user's own workspace would add: the package ward_msgs."""


class NotInstallableError(Exception):
    """The wheels cannot be installed here; the text says why, and what to do."""


def install() -> Path:
    """Return the folder of ROS 2, making it from the pinned requirements if it is not there. Raises NotInstallableError."""
    pins = [line for line in REQUIREMENTS.read_text().splitlines() if not line.startswith("#")]
    wanted = hashlib.sha256("\n".join([*pins, sys.version]).encode()).hexdigest()
    prefix = ENVIRONMENTS / f"ros2-{wanted[:16]}"
    stamp = prefix / "requirements.sha256"
    ENVIRONMENTS.mkdir(mode=0o700, parents=True, exist_ok=True)
    with (ENVIRONMENTS / "ros2.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not stamp.exists() or stamp.read_text() != wanted:
            subprocess.run([sys.executable, "-m", "venv", "--clear", "--without-pip", prefix], check=True)
            pip = [sys.executable, "-m", "pip", "--python", prefix / "bin" / "python", "--disable-pip-version-check"]
            options = ["--quiet", "--no-deps", "--require-hashes", "--only-binary", ":all:"]
            done = subprocess.run(
                [*pip, "install", *options, "--requirement", REQUIREMENTS], capture_output=True, text=True, check=False
            )
            if done.returncode:
                raise NotInstallableError(_refusal(done.stderr.strip()[-1_000:]))
            stamp.write_text(wanted)
    return prefix


def _refusal(said: str) -> str:
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    return (
        f"Tests of ROS 2 need wheels that cannot be installed with Python {version} here (there are some for 3.11 on "
        f"Linux on x86-64): {said}\n"
        "Next step: make the environment with Python 3.11 (`make clean`, then `make test PYTHON=python3.11`), with a "
        f"package index in reach,\nor leave them out (they are counted at the end):\n  {WAY_OUT}"
    )


def sourced(prefix: Path, *, workspace: bool = True) -> dict[str, str]:
    """Return the environment of a terminal in which ROS 2 was sourced, and the test's workspace too unless told not to."""
    packages = prefix / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    libraries = [prefix / "lib", *sorted(packages.glob("ros_*.libs"))]
    paths = [*([WORKSPACE] if workspace else []), packages]
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("ROS", "RMW", "FASTDDS"))}
    return {
        **kept,
        "AMENT_PREFIX_PATH": str(prefix),
        "LD_LIBRARY_PATH": os.pathsep.join(str(path) for path in libraries),
        "PYTHONPATH": os.pathsep.join(str(path) for path in paths),
        "PYTHONWARNINGS": "",
    }


def main() -> int:
    """Install what is missing; return 0 if tests of ROS 2 can run then."""
    try:
        run_in_own_network(nothing, Path.cwd())
        install()
    except (NotInstallableError, NoOwnNetworkError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
