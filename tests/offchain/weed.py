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
from urllib.request import urlopen

import botocore.session
from botocore.config import Config
from botocore.exceptions import BotoCoreError, ClientError

from tests.cluster.network_under_test import find_base_port
from tests.offchain.server_environments import installed

ROOT = Path(__file__).resolve().parents[2]
REQUIREMENTS = ROOT / "tests" / "requirements-s3.txt"
HINT = "Set S3_ENDPOINT, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY to test against another server."
START_MAX_S, STOP_MAX_S = 60.0, 15.0
PORTS_COUNT, CLUSTER_PORTS_COUNT = 12, 16


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


def _write_identities(folder: Path, server: S3Server) -> None:
    credentials = [{"accessKey": server.access_key, "secretKey": server.secret_key}]
    actions = ["Admin", "Read", "Write", "List", "Tagging"]
    identities = [{"name": "custodian", "credentials": credentials, "actions": actions}]
    (folder / "s3.json").write_text(json.dumps({"identities": identities}))


def small_server(folder: Path, server: S3Server, port: int) -> list[str]:
    """Return the command of one process with a master, a volume server, a filer and S3; ports from `port` on."""
    _write_identities(folder, server)
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
        "-s3.port.iceberg=0",
        "-s3.port.lance=0",
    ]
    return [str(command), "-logtostderr", "server", *options, *limits]


class Cluster:
    """Three masters, three volume servers in three racks with two copies of everything, a filer with S3."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port = folder, find_base_port(CLUSTER_PORTS_COUNT)
        self._weed = str(installed("seaweedfs", REQUIREMENTS, HINT) / "weed")
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self.server = S3Server(f"http://127.0.0.1:{self._port + 14}", secrets.token_hex(8), secrets.token_hex(16))

    @property
    def _masters(self) -> list[str]:
        return [f"127.0.0.1:{self._port + 2 * number}.{self._port + 2 * number + 1}" for number in range(3)]

    def __enter__(self) -> Cluster:
        _write_identities(self._folder, self.server)
        for number in range(3):
            self.start(f"master-{number}")
        for number in range(3):
            self.start(f"volume-{number}")
        for name in ("filer", "s3"):
            self.start(name)
        try:
            _wait_until_it_writes(self.server, self._children["s3"], self._folder / "s3.log")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for child in self._children.values():
            child.kill()
        for child in self._children.values():
            child.wait()

    def start(self, name: str) -> None:
        kind, _, number = name.partition("-")
        place = self._folder / name
        place.mkdir(exist_ok=True)
        masters = ",".join(self._masters)
        base = self._port + {"master": 0, "volume": 6, "filer": 12, "s3": 14}[kind] + 2 * int(number or 0)
        ports = [f"-port={base}", f"-port.grpc={base + 1}", "-ip=127.0.0.1"]
        options = {
            "master": [f"-mdir={place}", f"-peers={masters}", "-defaultReplication=010", "-volumeSizeLimitMB=64"],
            "volume": [f"-dir={place}", f"-master={masters}", f"-rack=rack-{number}", "-max=40"],
            "filer": [f"-master={masters}", f"-defaultStoreDir={place}"],
            "s3": [f"-filer=127.0.0.1:{self._port + 12}.{self._port + 13}", f"-config={self._folder / 's3.json'}"],
        }[kind]
        if kind == "master":
            options += ["-telemetry=false", "-electionTimeout=2s"]
        if kind == "s3":
            ports[-1] = "-ip.bind=127.0.0.1"
            options += ["-iam=false", "-autoCreateBucket=false", "-port.iceberg=0", "-port.lance=0"]
        with (self._folder / f"{name}.log").open("ab") as log:
            command = [self._weed, "-logtostderr", kind, *ports, *options]
            self._children[name] = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def kill(self, name: str) -> None:
        self._children[name].kill()
        self._children[name].wait()

    def leading_master(self) -> str:
        """As one of those that run says."""
        for number in range(3):
            if self._children[f"master-{number}"].poll() is None:
                with urlopen(f"http://127.0.0.1:{self._port + 2 * number}/cluster/status", timeout=5) as answer:
                    leader = json.load(answer)["Leader"].partition(":")[2].partition(".")[0]
                return f"master-{(int(leader) - self._port) // 2}"
        raise RuntimeError("No master runs.")


@contextmanager
def running() -> Iterator[S3Server]:
    """Run a small server over a temporary directory."""
    with tempfile.TemporaryDirectory(prefix="blockrobot-s3-") as name:
        folder, port = Path(name), find_base_port(PORTS_COUNT)
        server = S3Server(f"http://127.0.0.1:{port + 6}", secrets.token_hex(8), secrets.token_hex(16))
        with (folder / "server.log").open("wb") as log:
            child = subprocess.Popen(
                small_server(folder, server, port), stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        try:
            _wait_until_it_writes(server, child, folder / "server.log")
            yield server
        finally:
            child.terminate()
            try:
                child.wait(STOP_MAX_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def _wait_until_it_writes(server: S3Server, child: subprocess.Popen[bytes], log: Path) -> None:
    """Raises RuntimeError if it does not in time."""
    deadline, client = time.monotonic() + START_MAX_S, server.client()
    while time.monotonic() < deadline and child.poll() is None:
        try:
            if "started" not in {bucket["Name"] for bucket in client.list_buckets()["Buckets"]}:
                client.create_bucket(Bucket="started")
            client.put_object(Bucket="started", Key="one", Body=b"1")
        except (BotoCoreError, ClientError):
            time.sleep(0.2)
            continue
        client.close()
        return
    raise RuntimeError(f"The S3 server of the tests did not start: {log.read_text()[-2000:]}")


@contextmanager
def given_or_running() -> Iterator[S3Server]:
    """Yield the server of S3_ENDPOINT if it is set, else one that runs as long as the context."""
    endpoint = os.environ.get("S3_ENDPOINT")
    if endpoint:
        yield S3Server(endpoint, os.environ["AWS_ACCESS_KEY_ID"], os.environ["AWS_SECRET_ACCESS_KEY"])
    else:
        with running() as server:
            yield server
