"""A MongoDB-compatible server for the tests: SecantusDB, as a child process in an environment of its own.

It is beta and GPL, so it is for tests only, and what passes here has not been tested on MongoDB itself. Installing fails
loudly. `python -m tests.offchain.secantus` starts one, prints its URI, and runs until it is interrupted.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pymongo import MongoClient
from pymongo.errors import PyMongoError

from tests.cluster.network_under_test import find_base_port
from tests.offchain.server_environments import installed

ROOT = Path(__file__).resolve().parents[2]
REQUIREMENTS = ROOT / "tests" / "requirements-mongo.txt"
HINT = "Set MONGO_URI to the URI of a MongoDB server to test against that instead."
START_MAX_S = 60.0
STOP_MAX_S = 15.0


def install() -> Path:
    return installed("secantus", REQUIREMENTS, HINT) / "secantusd-py"


def choose_port() -> int:
    """Return a free port of the loopback interface, below those that the system gives to connections by itself."""
    return find_base_port(1)


def _log_of(storage: Path) -> str:
    return (storage / "server.log").read_text(errors="replace")[-2000:]


def start(storage: Path, port: int) -> subprocess.Popen[bytes]:
    """Start the server on loopback over a directory and return once it answers. Raises RuntimeError if it does not."""
    log = (storage / "server.log").open("ab")
    command = [install(), "--host", "127.0.0.1", "--port", str(port), "--storage-path", storage / "data"]
    options = ["--sync-on-commit", "--log-level", "WARNING"]
    child = subprocess.Popen([*command, *options], stdin=subprocess.DEVNULL, stdout=log, stderr=log)
    log.close()
    deadline = time.monotonic() + START_MAX_S
    with MongoClient(uri_of(port), serverSelectionTimeoutMS=500) as client:
        while time.monotonic() < deadline and child.poll() is None:
            try:
                client.admin.command("ping")
            except PyMongoError:
                continue
            return child
    stop(child)
    raise RuntimeError(f"The test server did not start: {_log_of(storage)}")


def stop(child: subprocess.Popen[bytes]) -> None:
    """Stop the server, by force if it takes too long."""
    child.terminate()
    try:
        child.wait(STOP_MAX_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def uri_of(port: int) -> str:
    """Return the server's URI, to which a database's name may be inserted before the question mark."""
    return f"mongodb://127.0.0.1:{port}/?directConnection=true"


@contextmanager
def running() -> Iterator[str]:
    """Run a server over a temporary directory; yields its URI."""
    with tempfile.TemporaryDirectory(prefix="blockrobot-mongo-") as storage:
        port = choose_port()
        child = start(Path(storage), port)
        try:
            yield uri_of(port)
        finally:
            ended = child.poll()
            stop(child)
        if ended is not None:
            raise RuntimeError(f"The test server ended by itself with {ended}: {_log_of(Path(storage))}")


@contextmanager
def given_or_running() -> Iterator[str]:
    """Yield MONGO_URI if it is set, else the URI of a server that runs as long as the context."""
    given = os.environ.get("MONGO_URI")
    if given:
        yield given
    else:
        with running() as uri:
            yield uri


def main() -> None:
    """Run a server until SIGINT or SIGTERM."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with running() as uri:
        print(uri, flush=True)  # noqa: T201 - the URI is what the command is for
        try:
            signal.pause()
        except KeyboardInterrupt:
            sys.exit(0)


if __name__ == "__main__":
    main()
