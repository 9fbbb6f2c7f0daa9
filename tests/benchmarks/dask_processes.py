"""A scheduler and workers of Dask as processes, with the certificates and the configuration that the how-to page makes."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "how-to" / "compute-on-a-cluster.md").read_text(encoding="utf-8")
START_MAX_S, END_MAX_S = 120.0, 20.0
POLL_S = 0.1


def write_configuration(folder: Path) -> Path:
    """Type what the page says for certificates, and write its file for them."""
    folder.mkdir()
    for line in re.findall(r"^openssl .*$", PAGE, re.MULTILINE):
        subprocess.run(shlex.split(line), cwd=folder, check=True, capture_output=True)
    (file,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (folder / "cluster.yaml").write_text(file.replace("/etc/blockrobot-cluster", str(folder)))
    return folder


class DaskProcesses:
    """What was started under a folder; all of it ends with the context."""

    def __init__(self, folder: Path, configuration: Path, **settings: str) -> None:
        self._folder, self._children = folder, list[subprocess.Popen[bytes]]()
        self.environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_CONFIG": str(configuration), **settings}
        self.address = ""

    def start_scheduler(self) -> None:
        place = ("--protocol", "tls", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", "at.json")
        self.scheduler = self._start("scheduler", *place)
        self.address = json.loads(self.wait_for(self._read))["address"]

    def start_worker(self, *options: str, source: Path = ROOT) -> subprocess.Popen[bytes]:
        given = ("--nthreads", "1") if "--nthreads" not in options else ()
        where = ("--host", "127.0.0.1", "--local-directory", str(self._folder))
        return self._start("worker", self.address, *where, *given, *options, source=source)

    def workers(self, client: Any, count: int) -> dict[str, int]:
        """Wait for so many; return their processes by address."""

        def found() -> dict[str, int] | None:
            pids: dict[str, int] = client.run(os.getpid, on_error="ignore")
            return pids if len(pids) == count else None

        return self.wait_for(found)

    def wait_for(self, look: Any) -> Any:
        end = time.monotonic() + START_MAX_S
        while not (found := look()):
            assert time.monotonic() < end, [path.read_text()[-2_000:] for path in self._folder.glob("*.log")]
            time.sleep(POLL_S)
        return found

    def end(self) -> None:
        for child in reversed(self._children):
            child.terminate()
        for child in reversed(self._children):
            with suppress(subprocess.TimeoutExpired):
                child.wait(END_MAX_S)
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)  # what a killed worker's nanny was just starting, too
            child.wait()

    def _read(self) -> str:
        path = self._folder / "at.json"
        text = path.read_text() if path.exists() else ""
        return text if text.endswith("}") else ""

    def _start(self, kind: str, *options: str, source: Path = ROOT) -> subprocess.Popen[bytes]:
        quiet = ("--no-dashboard", "--dashboard-address", "127.0.0.1:0")
        with (self._folder / f"{kind}-{len(self._children)}.log").open("wb") as log:
            child = subprocess.Popen(
                [sys.executable, "-m", "dask", kind, *options, *quiet],
                cwd=self._folder,
                env=self.environment | {"PYTHONPATH": str(source)},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self._children.append(child)
        return child


@contextmanager
def dask_processes(folder: Path, configuration: Path, **settings: str) -> Iterator[DaskProcesses]:
    folder.mkdir()
    started = DaskProcesses(folder, configuration, **settings)
    try:
        started.start_scheduler()
        yield started
    finally:
        started.end()
