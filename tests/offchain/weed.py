"""An S3 server for the tests: SeaweedFS, as a child process in an environment of its own, on loopback."""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import botocore.session
from botocore.config import Config
from botocore.exceptions import BotoCoreError, ClientError

from tests.cluster.network_under_test import find_base_port
from tests.offchain.server_environments import installed

ROOT = Path(__file__).resolve().parents[2]
REQUIREMENTS = ROOT / "tests" / "requirements-s3.txt"
HINT = "Set S3_ENDPOINT, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY to test against another server."
START_MAX_S, STOP_MAX_S = 60.0, 15.0
PORTS_COUNT = 12


@dataclass(frozen=True, slots=True)
class S3Server:
    endpoint: str
    access_key: str
    secret_key: str

    def write_credentials(self, path: Path, secret_key: str = "") -> Path:
        """As the AWS tools read them; another secret key, if given."""
        lines = (f"aws_access_key_id = {self.access_key}", f"aws_secret_access_key = {secret_key or self.secret_key}")
        path.write_text("\n".join(["[default]", *lines, ""]))
        return path

    def client(self) -> Any:
        config = Config(
            connect_timeout=2, read_timeout=10, retries={"total_max_attempts": 1}, s3={"addressing_style": "path"}
        )
        return botocore.session.get_session().create_client(
            "s3",
            region_name="us-east-1",
            endpoint_url=self.endpoint,
            aws_access_key_id=self.access_key,
            aws_secret_access_key=self.secret_key,
            config=config,
        )


def small_server(folder: Path, keys: tuple[str, str], port: int) -> list[str]:
    """Return the command of one process with a master, a volume server, a filer and S3; ports from `port` on."""
    (folder / "s3.json").write_text(
        json.dumps(
            {
                "identities": [
                    {
                        "name": "custodian",
                        "credentials": [{"accessKey": keys[0], "secretKey": keys[1]}],
                        "actions": ["Admin", "Read", "Write", "List", "Tagging"],
                    }
                ]
            }
        )
    )
    (folder / "data").mkdir(exist_ok=True)
    named = ("master.port", "master.port.grpc", "volume.port", "volume.port.grpc", "filer.port", "filer.port.grpc")
    ports = [f"-{name}={port + place}" for place, name in enumerate((*named, "s3.port", "s3.port.grpc"))]
    command = installed("seaweedfs", REQUIREMENTS, HINT) / "weed"
    options = ["-ip=127.0.0.1", f"-dir={folder / 'data'}", "-s3", f"-s3.config={folder / 's3.json'}", *ports]
    limits = [
        "-master.volumeSizeLimitMB=64",
        "-volume.max=40",
        "-master.telemetry=false",
        "-s3.iam=false",
        "-s3.autoCreateBucket=false",
    ]
    return [str(command), "-logtostderr", "server", *options, *limits]


@contextmanager
def running() -> Iterator[S3Server]:
    """Run a small server over a temporary directory."""
    with tempfile.TemporaryDirectory(prefix="blockrobot-s3-") as name:
        folder, port = Path(name), find_base_port(PORTS_COUNT)
        server = S3Server(f"http://127.0.0.1:{port + 6}", secrets.token_hex(8), secrets.token_hex(16))
        keys = (server.access_key, server.secret_key)
        with (folder / "server.log").open("wb") as log:
            child = subprocess.Popen(small_server(folder, keys, port), stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            _wait_until_it_writes(server, child, folder)
            yield server
        finally:
            child.terminate()
            try:
                child.wait(STOP_MAX_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def _wait_until_it_writes(server: S3Server, child: subprocess.Popen[bytes], folder: Path) -> None:
    """Raises RuntimeError if it does not in time."""
    deadline, client = time.monotonic() + START_MAX_S, server.client()
    while time.monotonic() < deadline and child.poll() is None:
        try:
            client.create_bucket(Bucket="started")
            client.put_object(Bucket="started", Key="one", Body=b"1")
        except (BotoCoreError, ClientError):
            time.sleep(0.2)
            continue
        client.close()
        return
    raise RuntimeError(f"The S3 server of the tests did not start: {(folder / 'server.log').read_text()[-2000:]}")


@contextmanager
def given_or_running() -> Iterator[S3Server]:
    """Yield the server of S3_ENDPOINT if it is set, else one that runs as long as the context."""
    endpoint = os.environ.get("S3_ENDPOINT")
    if endpoint:
        yield S3Server(endpoint, os.environ["AWS_ACCESS_KEY_ID"], os.environ["AWS_SECRET_ACCESS_KEY"])
    else:
        with running() as server:
            yield server
