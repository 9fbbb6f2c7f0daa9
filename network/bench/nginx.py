"""Starts nginx before a node, by the configuration that is shipped."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

from clients.sdk.new_files import replace_file
from consensus.errors import BlockRobotError
from node.config import CONFIG_FILE, config_to_toml, load_config

SHIPPED = Path(__file__).resolve().parents[2] / "deploy" / "nginx" / "blockrobot.conf"
START_MAX_S, STOP_MAX_S, POLL_S = 10.0, 10.0, 0.05
PACKAGE = "nginx-light"
_MAIN = """\
daemon off;
user root root;
pid {place}/nginx.pid;
error_log {place}/error.log warn;
worker_processes 1;
worker_rlimit_nofile 8192;
events {{ worker_connections 4096; }}
http {{
    access_log off;
    client_body_temp_path {place}/body;
    proxy_temp_path {place}/proxy;
    fastcgi_temp_path {place}/fastcgi;
    uwsgi_temp_path {place}/uwsgi;
    scgi_temp_path {place}/scgi;
    {includes}
}}
"""


def find_nginx() -> str:
    """Raises PROGRAM_MISSING."""
    found = shutil.which("nginx", path="/usr/sbin:/usr/bin:/usr/local/sbin:/usr/local/bin")
    if found is None:
        raise BlockRobotError("PROGRAM_MISSING", f"nginx is not here: on Debian, apt-get install {PACKAGE}.")
    return found


def trust_proxy(data_dir: Path, address: str) -> None:
    """Let a node that does not run believe a proxy's header."""
    config = replace(load_config(data_dir), trusted_proxies=(address,))
    replace_file(data_dir / CONFIG_FILE, config_to_toml(config).encode())


def configure(node: str, listen: str, name: str, certificates: Path) -> str:
    """The shipped file with these four in place of its own: the node's port, ours, our name, tls.*.pem.

    Raises PROGRAM_MISSING, CONFIGURATION_INVALID.
    """
    if not SHIPPED.is_file():
        raise BlockRobotError("PROGRAM_MISSING", f"{SHIPPED} is not there: run this from a clone of BlockRobot.")
    text = SHIPPED.read_text(encoding="utf-8")
    for old, new in (
        ("server 127.0.0.1:7273;", f"server {node};"),
        ("listen 443 ", f"listen {listen} "),
        ("ward-1.hospital.example", name),
        ("/etc/blockrobot/proxy/", f"{certificates}/"),
    ):
        if old not in text:
            raise BlockRobotError("CONFIGURATION_INVALID", f"{SHIPPED.name} has no {old!r}.")
        text = text.replace(old, new)
    return text


def count_bodies_on_disk(place: Path) -> int:
    """How often the nginx of this folder wrote a request's body to its disk, by its own warnings: the file has no name."""
    return (place / "error.log").read_text(encoding="utf-8", errors="replace").count("buffered to a temporary file")


class Nginx:
    """One nginx that runs as `with` lasts; `prefix` are the first words of a command on its host."""

    def __init__(self, place: Path, configuration: str, prefix: Sequence[str] = ()) -> None:
        place.mkdir(parents=True)
        self._place = place
        (place / "blockrobot.conf").write_text(configuration, encoding="utf-8")
        main = _MAIN.format(place=place, includes=f"include {place}/blockrobot.conf;")
        (place / "nginx.conf").write_text(main, encoding="utf-8")
        self._command = [*prefix, find_nginx(), "-p", str(place), "-c", str(place / "nginx.conf")]
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        log = self._place / "output.log"
        with log.open("wb") as output:
            self._process = subprocess.Popen(self._command, stdout=output, stderr=subprocess.STDOUT)
        deadline_s = time.monotonic() + START_MAX_S
        while not (self._place / "nginx.pid").is_file():
            if self._process.poll() is not None or time.monotonic() > deadline_s:
                self._stop()
                said = log.read_text(encoding="utf-8", errors="replace").strip()
                raise BlockRobotError("CONFIGURATION_INVALID", f"nginx did not start: {said}")
            time.sleep(POLL_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def _stop(self) -> None:
        if self._process is None or self._process.poll() is not None:
            return
        self._process.terminate()
        try:
            self._process.wait(STOP_MAX_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
