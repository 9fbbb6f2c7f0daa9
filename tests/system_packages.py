"""Installs the Debian packages that tests need, where they are missing: a browser, a film, fonts, ROS 1, Prometheus.

Run by `make test` before the tests, with any Python and nothing installed; by `make test-long` with what that tier alone
needs. Must never install anything else, never ask for a password, and never end well with something missing.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

OPENCV_DOC = "/usr/share/doc/opencv-doc/*"
DEBIAN_PYTHON = Path("/usr/lib/python3/dist-packages")
ENSUREPIP = next(
    iter(sorted(Path("/usr/lib").glob("python3.*/ensurepip/__init__.py"))), Path("/usr/lib/python3/ensurepip")
)
PEDESTRIANS = Path("/usr/share/doc/opencv-doc/examples/data/vtest.avi")
SYSTEMD_RUNS = Path("/run/systemd/system")
WAY_OUT = "make test SYSTEM_PACKAGES=none"


@dataclass(frozen=True)
class Package:
    """A Debian package, what tests need it for, what tells that it is there (any of some programs, or a file), and what
    its installation starts that nobody asked for."""

    name: str
    purpose: str
    programs: tuple[str, ...] = ()
    file: Path | None = None
    service: str = ""
    is_for_long_tests: bool = False

    def is_there(self) -> bool:
        """Tell whether what is needed is here, wherever it came from."""
        if self.file is not None:
            return self.file.is_file()
        return any(shutil.which(program) for program in self.programs)


PACKAGES = (
    Package("chromium", "opens our pages", programs=("chromium", "chromium-browser")),
    Package("graphviz", "draws the process map", programs=("dot",)),
    Package("systemd", "checks our units", programs=("systemd-analyze",)),
    Package("opencv-doc", "has a film of real pedestrians", file=PEDESTRIANS),
    Package(
        "fonts-liberation2",
        "lets pages look alike everywhere",
        file=Path("/usr/share/fonts/truetype/liberation2/LiberationSans-Regular.ttf"),
    ),
    Package("python3-rosmaster", "runs a ROS 1 graph", file=Path("/usr/bin/rosmaster")),
    Package("python3-rospy", "is how a robot of ROS 1 is heard", file=DEBIAN_PYTHON / "rospy" / "__init__.py"),
    Package("python3-sensor-msgs", "knows the messages of cameras", file=DEBIAN_PYTHON / "sensor_msgs" / "__init__.py"),
    Package(
        "prometheus",
        "reads our metrics by our rules",
        programs=("promtool",),
        service="prometheus.service",
        is_for_long_tests=True,
    ),
    Package(
        "nginx-light",
        "stands before nodes",
        programs=("nginx", "/usr/sbin/nginx"),
        service="nginx.service",
        is_for_long_tests=True,
    ),
    Package("python3-venv", "installs programs on hosts", file=ENSUREPIP, is_for_long_tests=True),
    Package("mmdebstrap", "makes the image's system", programs=("mmdebstrap",), is_for_long_tests=True),
    Package("umoci", "makes an image", programs=("umoci",), is_for_long_tests=True),
    Package("systemd-container", "boots a system with our units", programs=("systemd-nspawn",), is_for_long_tests=True),
    Package("crun", "starts an image", programs=("crun",), is_for_long_tests=True),
)


class CannotInstallError(Exception):
    """Packages are missing and cannot be installed here; the text says why."""


def find_missing(tier: str = "") -> list[Package]:
    """Return what is not here, and what the long tier alone needs only if it is `long`."""
    wanted = [package for package in PACKAGES if tier == "long" or not package.is_for_long_tests]
    return [package for package in wanted if not package.is_there()]


def find_rights() -> list[str]:
    """Return what goes before `apt-get`: nothing for root, `sudo -n` for who may. Raises CannotInstallError."""
    if shutil.which("apt-get") is None:
        raise CannotInstallError("this system has no apt-get")
    if os.geteuid() == 0:
        return []
    if shutil.which("sudo") is None:
        raise CannotInstallError("you are not root, and there is no sudo")
    if subprocess.run(["sudo", "-n", "true"], capture_output=True, check=False).returncode != 0:
        raise CannotInstallError("you are not root, and sudo would ask for a password")
    return ["sudo", "-n"]


def install(missing: list[Package]) -> None:
    """Install packages by apt-get. Raises CannotInstallError."""
    rights = find_rights()
    # Small systems are set to leave /usr/share/doc out, and that is where the film is.
    options = ["--yes", "--no-install-recommends", "--reinstall", "-o", f"Dpkg::Options::=--path-include={OPENCV_DOC}"]
    quiet = ["env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq"]
    for step in (["update"], ["install", *options, *(package.name for package in missing)]):
        done = subprocess.run(
            [*rights, *quiet, *step], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            told = (done.stderr or done.stdout).strip().splitlines() or ["it said nothing"]
            raise CannotInstallError(f"`apt-get {step[0]}` failed: {told[-1]}")
    services = [package.service for package in missing if package.service]
    if services and SYSTEMD_RUNS.is_dir():
        subprocess.run([*rights, "systemctl", "--quiet", "disable", "--now", *services], check=False)
    if still := [package.name for package in missing if not package.is_there()]:
        raise CannotInstallError(f"`apt-get install` ended well, and {', '.join(still)} is not here all the same")


def refuse(missing: list[Package], reason: str) -> str:
    """Return what is said where nothing can be installed: what is missing and why, and what to type."""
    names = " ".join(package.name for package in missing)
    lines = [f"Tests need Debian packages that are not here, and they cannot be installed: {reason}."]
    lines += [f"  {package.name}: {package.purpose}" for package in missing]
    lines += [
        "Next step: install them, on Debian or Ubuntu by",
        f"  sudo apt-get update && sudo apt-get install --no-install-recommends {names}",
        "or leave out the tests that need them (they are counted at the end):",
        f"  {WAY_OUT}",
    ]
    return "\n".join(lines)


def say_left_out() -> str:
    """Return what is said before tests that need these packages are left out."""
    named = ", ".join(package.name for package in PACKAGES)
    return f"SYSTEM_PACKAGES=none: tests that need {named} are left out, and counted at the end."


def main(wish: str = "install", tier: str = "") -> int:
    """Install what is missing; return 0 if then everything is here. `wish` "none": only say what is left out."""
    if wish == "none":
        sys.stdout.write(say_left_out() + "\n")
        return 0
    missing = find_missing(tier)
    if not missing:
        return 0
    what = ", ".join(f"{package.name} ({package.purpose})" for package in missing)
    sys.stdout.write(f"Installing for the tests, by apt-get: {what}.\n")
    sys.stdout.flush()
    try:
        install(missing)
    except CannotInstallError as error:
        sys.stderr.write(refuse(missing, str(error)) + "\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
