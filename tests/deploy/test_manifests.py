"""Manifests for Kubernetes, files for Compose and the Containerfile, which cannot be run here: what validators say, and
BlockRobot itself."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from pymongo.uri_parser import parse_uri

from network.provisioning.network_layout import FIRST_PORT, PORTS_PER_NODE
from network.provisioning.new_node import store_uri_of
from node.config import NodeConfig
from tests.architecture.test_commands_in_documents import fault_of
from tests.deploy.tools import DEPLOY, ROOT, judge

COMPOSE = sorted((DEPLOY / "compose").glob("*.yaml"))
KUBERNETES = sorted((DEPLOY / "kubernetes").rglob("*.yaml"))
OVERLAY = DEPLOY / "kubernetes" / "overlays" / "hospital"
DATA_DIR = "/var/lib/blockrobot/node"


def read(path: Path) -> list[Any]:
    return list(yaml.safe_load_all(path.read_text(encoding="utf-8")))


def pod_of(stateful_set: Any) -> Any:
    return stateful_set["spec"]["template"]["spec"]


@pytest.mark.parametrize("path", [*COMPOSE, *KUBERNETES], ids=lambda path: str(path.relative_to(DEPLOY)))
def test_every_file_parses_and_says_first_that_it_was_not_run(path: Path) -> None:
    documents = read(path)
    assert documents
    assert all(documents)
    if path.name != "kustomization.yaml":
        assert re.search(r"\b[Nn]ot run\b", path.read_text(encoding="utf-8").splitlines()[0])


def test_four_services_run_four_nodes_of_the_network_that_the_fifth_makes() -> None:
    (described,) = read(DEPLOY / "compose" / "compose.yaml")
    setup, *nodes = described["services"].values()
    assert [service["command"] for service in nodes] == [["node", "run", f"node-{number}"] for number in range(1, 5)]
    assert [fault_of(" ".join(service["command"])) for service in nodes] == [None] * 4
    operators = [FIRST_PORT + PORTS_PER_NODE * number + 2 for number in range(4)]
    assert [service["environment"]["OPERATOR_PORT"] for service in nodes] == operators
    assert "blockrobot up" in setup["command"][0]
    for service in (setup, *nodes):
        assert (service["read_only"], service["cap_drop"], "privileged" in service) == (True, ["ALL"], False)


def test_the_store_that_nodes_are_given_is_the_replica_set_of_three_that_is_made() -> None:
    (described,) = read(DEPLOY / "compose" / "mongodb.yaml")
    services = described["services"]
    members = [service["command"] for name, service in services.items() if re.fullmatch(r"mongo-\d", name)]
    addresses = [f"{option(member, '--bind_ip')}:{option(member, '--port')}" for member in members]
    assert len(set(addresses)) == 3
    assert all(address.startswith("127.0.0.1:") for address in addresses), "nothing listens beyond the machine"
    uri = parse_uri(services["setup"]["environment"]["STORE"])
    assert [f"{host}:{port}" for host, port in uri["nodelist"]] == addresses
    assert {option(member, "--replSet") for member in members} == {uri["options"]["replicaSet"]}
    script = services["mongo-init"]["command"][-1]
    assert re.findall(r'host: "([^"]+)"', script) == addresses
    assert f'_id: "{uri["options"]["replicaSet"]}"' in script
    own = store_uri_of(services["setup"]["environment"]["STORE"], "ward-1", "node-1")
    assert parse_uri(own)["options"] == uri["options"], "a node's own database is on the same set"


def option(words: list[str], name: str) -> str:
    return words[words.index(name) + 1]


def test_a_node_in_a_pod_is_one_that_its_command_and_its_settings_know() -> None:
    stateful_set, *_ = read(DEPLOY / "kubernetes" / "node" / "node.yaml")
    (container,), (waiting,) = pod_of(stateful_set)["containers"], pod_of(stateful_set)["initContainers"]
    assert fault_of(" ".join(container["args"])) is None
    assert container["args"][-1] == DATA_DIR
    assert f"test -e {DATA_DIR}/node.toml" in waiting["command"][-1]
    mounted = {mount["name"]: mount["mountPath"] for mount in container["volumeMounts"]}
    assert mounted["erase-keys"] == str(NodeConfig.erase_keys_dir.fget(SimpleNamespace(data_dir=Path(DATA_DIR))))
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert (ports["peers"], ports["clients"]) == (FIRST_PORT, FIRST_PORT + 1)
    assert stateful_set["spec"]["replicas"] == 1, "one key at one place"


def test_an_image_is_built_of_what_is_named_and_its_last_stage_of_wheels() -> None:
    lines = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    patterns = [line for line in lines if not line.startswith("#")]
    with (ROOT / "pyproject.toml").open("rb") as file:
        packages = tomllib.load(file)["tool"]["setuptools"]["packages"]["find"]["include"]
    pins = {f"requirements/{name}.txt" for name in ("build", "runtime", "s3")}
    files = {"LICENSE", "README.md", "pyproject.toml", *pins}
    assert patterns[0] == "*"
    let_in = {pattern[1:] for pattern in patterns if pattern.startswith("!")}
    assert let_in == files | {package.rstrip("*") for package in packages}
    *_, last = (DEPLOY / "image" / "Containerfile").read_text(encoding="utf-8").split("\nFROM ")
    assert not {"COPY", "ADD"} & {line.split(" ")[0] for line in last.splitlines()}


@pytest.mark.long
def test_an_organisations_nodes_are_apart_and_hold_no_secret() -> None:
    built = judge("kubectl", "kustomize", OVERLAY)
    found = list(yaml.safe_load_all(built))
    of = {kind: [each for each in found if each["kind"] == kind] for kind in {each["kind"] for each in found}}
    assert not {"Secret", "ConfigMap"} & set(of)
    names = [each["metadata"]["name"] for each in of["StatefulSet"]]
    assert names == ["ward-1-node", "ward-2-node"]
    labels = [each["spec"]["template"]["metadata"]["labels"].items() for each in of["StatefulSet"]]
    for service in of["Service"]:
        selected = [service["spec"]["selector"].items() <= each for each in labels]
        assert sorted(selected) == [False, True], "a service leads to one node"
    for one in (*of["PodDisruptionBudget"], *of["NetworkPolicy"]):
        selector = one["spec"].get("selector") or one["spec"]["podSelector"]
        assert all(selector["matchLabels"].items() <= each for each in labels), "they speak of all nodes"
    secrets = [
        volume["secret"]["secretName"]
        for each in of["StatefulSet"]
        for volume in pod_of(each)["volumes"]
        if "secret" in volume
    ]
    assert secrets == ["ward-1-keys", "ward-2-keys"]
    for each in of["StatefulSet"]:
        (term,) = pod_of(each)["affinity"]["podAntiAffinity"]["preferredDuringSchedulingIgnoredDuringExecution"]
        (wanted,) = term["podAffinityTerm"]["labelSelector"]["matchExpressions"]
        assert all(dict(other)[wanted["key"]] in wanted["values"] for other in labels), "they keep away from each other"
        for container in (*pod_of(each)["containers"], *pod_of(each)["initContainers"]):
            guarded = container["securityContext"]
            assert guarded["readOnlyRootFilesystem"]
            assert not guarded["allowPrivilegeEscalation"]
            assert guarded["capabilities"] == {"drop": ["ALL"]}
        assert pod_of(each)["securityContext"]["runAsNonRoot"]


@pytest.mark.long
def test_validators_find_nothing_wrong(tmp_path: Path) -> None:
    built = tmp_path / "built.yaml"
    built.write_text(judge("kubectl", "kustomize", OVERLAY), encoding="utf-8")
    judge("kubernetes-validate", "--strict", built)
    judge("check-jsonschema", "--builtin-schema", "vendor.compose-spec", *COMPOSE)


@pytest.mark.long
def test_a_mistake_is_found(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(judge("kubectl", "kustomize", OVERLAY).replace("periodSeconds", "periodSecond"), encoding="utf-8")
    with pytest.raises(AssertionError, match="periodSecond"):
        judge("kubernetes-validate", "--strict", wrong)
    service = tmp_path / "compose.yaml"
    service.write_text("services: {a: {imag: b}}\n", encoding="utf-8")
    with pytest.raises(AssertionError, match="imag"):
        judge("check-jsonschema", "--builtin-schema", "vendor.compose-spec", service)
