"""The image, built without a daemon and started by crun, runs what compose.yaml and the StatefulSet say."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from network.lab.hosts.namespaces import Host, Hosts
from tests.deploy.tools import DEPLOY, ROOT, make

IMAGE = ROOT / "build" / "image"
IMAGE_MAX_BYTES = 400 * 1024**2
USER = 10001
PYTHON = "/usr/bin/python3"
STORY_MAX_S = 1_800
START_MAX_S = 300
CRUN = ["unshare", "--mount", "sh", "-c", 'mount -t cgroup2 none /sys/fs/cgroup && exec crun "$@"', "crun"]
CRUN += ["--cgroup-manager=disabled"]
"""It refuses to run where two kinds of control groups are mounted, though it is told to use none."""
WAITS_S = 3
ENTRIES = ("network/organisations/hospital/organisation-entry.json", "network/nodes/ward-1/node-entry.json")
BIN = Path(sys.executable).parent
pytestmark = [pytest.mark.timeout(STORY_MAX_S), pytest.mark.system_packages]


@pytest.fixture(scope="module")
def settings() -> dict[str, Any]:
    """What the image says of itself."""
    make("image", PYTHON)

    def blob(digest: str) -> Any:
        return json.loads((IMAGE / "blobs" / digest.replace(":", "/")).read_text())

    (listed,) = json.loads((IMAGE / "index.json").read_text())["manifests"]
    manifest = blob(listed["digest"])
    assert sum(layer["size"] for layer in manifest["layers"]) < IMAGE_MAX_BYTES
    settings: dict[str, Any] = blob(manifest["config"]["digest"])["config"]
    return settings


class Containers:
    """Containers of the image on one host: a root that cannot be written, no capability, no more than its volumes."""

    def __init__(self, host: Host, place: Path) -> None:
        self._host = host
        self._place = place
        self.data = self.volume("data")
        unpacked = ["umoci", "unpack", "--image", f"{IMAGE}:latest", place / "bundle"]
        subprocess.run(unpacked, check=True, capture_output=True)
        self._said = json.loads((place / "bundle" / "config.json").read_text())

    def volume(self, name: str) -> Path:
        """An empty one, of the image's user."""
        made = self._place / name
        made.mkdir()
        os.chown(made, USER, USER)
        return made

    def start(self, name: str, arguments: list[str], *more: dict[str, Any]) -> subprocess.Popen[bytes]:
        """With the arguments that stand behind the entry point, or for it, and more mounts than its data."""
        given = json.loads(json.dumps(self._said))
        given["root"] = {"path": str(self._place / "bundle" / "rootfs"), "readonly": True}
        given["process"] |= {"terminal": False, "args": arguments, "noNewPrivileges": True}
        given["process"]["capabilities"] = {}
        given["linux"]["namespaces"] = [
            {"type": "network", "path": f"/run/netns/{self._host.namespace}"},
            *({"type": kind} for kind in ("pid", "ipc", "uts", "mount")),
        ]
        given["linux"].pop("resources", None)
        given["mounts"] = [each for each in given["mounts"] if each["type"] != "cgroup"] + [
            bind(self.data, "/var/lib/blockrobot"),
            {"destination": "/tmp", "type": "tmpfs", "source": "tmpfs", "options": ["mode=1777"]},
            *more,
        ]
        own = self._place / name
        own.mkdir()
        (own / "config.json").write_text(json.dumps(given))
        command = [*CRUN, "run", "--bundle", own, f"{self._host.namespace}-{name}"]
        with (own / "output").open("wb") as output:
            return subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)

    def output(self, name: str) -> str:
        return (self._place / name / "output").read_text()

    def stop(self, name: str) -> None:
        subprocess.run([*CRUN, "kill", f"{self._host.namespace}-{name}", "TERM"], check=True)

    def asks(self, url: str) -> bool:
        asked = [*self._host.prefix, "curl", "--silent", "--insecure", "--fail", "--max-time", "5", url]
        return subprocess.run(asked, capture_output=True, check=False).returncode == 0


@pytest.fixture
def containers(settings: dict[str, Any], tmp_path: Path) -> Iterator[Containers]:
    assert settings
    with Hosts(tmp_path / "hosts", ["one"]) as hosts:
        yield Containers(hosts.hosts["one"], tmp_path)


def bind(source: Path, destination: str, mode: str = "rw") -> dict[str, Any]:
    return {"type": "bind", "source": str(source), "destination": destination, "options": ["bind", mode]}


def wait(holds: Callable[[], bool], running: Collection[subprocess.Popen[bytes]]) -> None:
    deadline_s = time.monotonic() + START_MAX_S
    while not holds():
        assert [one.poll() for one in running] == [None] * len(running), "one has ended"
        assert time.monotonic() < deadline_s, "it did not come about"
        time.sleep(0.5)


def test_the_image_is_a_commands_and_not_roots(settings: dict[str, Any]) -> None:
    assert settings["User"] == "10001:10001"
    assert settings["Entrypoint"] == ["blockrobot"]
    assert settings["Volumes"] == {"/var/lib/blockrobot": {}}
    assert settings["Labels"]["org.opencontainers.image.licenses"] == "Apache-2.0"


def test_the_nodes_of_compose_run_in_it_and_end_when_they_are_told_to(containers: Containers) -> None:
    services = yaml.safe_load((DEPLOY / "compose" / "compose.yaml").read_text())["services"]
    setup = services.pop("setup")
    told = [*setup["entrypoint"], *(line.replace("$$", "$") for line in setup["command"])]
    assert containers.start("setup", told).wait(timeout=START_MAX_S) == 0, containers.output("setup")
    running = {name: containers.start(name, ["blockrobot", *each["command"]]) for name, each in services.items()}

    def answers(port: int, path: str) -> bool:
        return containers.asks(f"http://127.0.0.1:{port}/{path}")

    try:
        ports = [each["environment"]["OPERATOR_PORT"] for each in services.values()]
        wait(lambda: all(answers(port, "livez") and answers(port, "readyz") for port in ports), running.values())
        for name in running:
            containers.stop(name)
        ends = {name: one.wait(timeout=START_MAX_S) for name, one in running.items()}
        assert ends == dict.fromkeys(services, 0), [containers.output(name) for name in services]
    finally:
        for one in running.values():
            one.kill()


def test_a_pod_waits_for_its_nodes_folder_and_runs_with_keys_that_it_only_reads(
    containers: Containers, tmp_path: Path
) -> None:
    pod = next(yaml.safe_load_all((DEPLOY / "kubernetes" / "node" / "node.yaml").read_text()))["spec"]["template"][
        "spec"
    ]
    (waiting,), (container,) = pod["initContainers"], pod["containers"]
    desk = tmp_path / "desk"
    desk.mkdir()
    for typed in (
        "org new hospital",
        "node init ward-1 --founding --organisation hospital --custodian --bind 0.0.0.0 --advertise ward-1.example",
        f"genesis make {' '.join(ENTRIES)} --out genesis.json",
        "genesis check genesis.json --adopt",
    ):
        subprocess.run([BIN / "blockrobot", *typed.split()], cwd=desk, env={"BLOCKROBOT_HOME": str(desk)}, check=True)
    node = desk / "network" / "nodes" / "ward-1"
    with (node / "node.toml").open("a") as settings:
        settings.write('\n[metrics]\nhost = "0.0.0.0"\nport = 9100\n')

    first = containers.start("wait", waiting["command"])
    with pytest.raises(subprocess.TimeoutExpired):
        first.wait(timeout=WAITS_S)
    shutil.move(node / "keys", desk / "keys")  # what a Secret shows: of root, and for the group to read
    (desk / "keys").chmod(0o755)
    for path in (desk / "keys").iterdir():
        path.chmod(0o440)
        os.chown(path, 0, USER)
    subprocess.run(["chown", "-R", f"{USER}:{USER}", node], check=True)
    shutil.copytree(node, containers.data / "incoming")
    subprocess.run(["chown", "-R", f"{USER}:{USER}", containers.data], check=True)
    (containers.data / "incoming").rename(containers.data / "node")
    assert first.wait(timeout=START_MAX_S) == 0

    folder = "/var/lib/blockrobot/node"
    mounts = (bind(containers.volume("erased"), f"{folder}/erase-keys"), bind(desk / "keys", f"{folder}/keys", "ro"))
    running = containers.start("node", ["blockrobot", *container["args"]], *mounts)
    try:
        probes = [container[each]["httpGet"]["path"] for each in ("startupProbe", "livenessProbe", "readinessProbe")]
        assert probes == ["/livez", "/livez", "/readyz"]
        wait(lambda: all(containers.asks(f"https://127.0.0.1:9100{path}") for path in probes), [running])
        containers.stop("node")
        assert running.wait(timeout=START_MAX_S) == 0, containers.output("node")
    finally:
        running.kill()
    assert (tmp_path / "erased" / "erase-keys").is_file()
    assert not list(containers.data.rglob("*.key"))
