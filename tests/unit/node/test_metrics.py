"""What a node exposes is what the reference page lists, what the alerts and the dashboard ask for, and true."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path

import aiohttp
import pytest
from cryptography import x509
from prometheus_client.parser import text_string_to_metric_families

from consensus.chain.evidence import make_evidence
from consensus.chain.messages import sign_vote
from network.cluster import Cluster
from network.provisioning.network_layout import create_network
from node.config import reading_headers
from node.node_process import Node
from tests.architecture.test_commands_in_documents import fault_of
from tests.cluster.network_under_test import find_base_port
from tests.unit.node.small_nodes import SmallNodes, make_genesis, producer_key
from tests.virtual_time import in_virtual_time

ROOT = Path(__file__).resolve().parents[3]
MONITORING = ROOT / "deploy" / "monitoring"
REFERENCE = ROOT / "docs" / "reference" / "metrics.md"
NAME = re.compile(r"\b(?:blockrobot|process)_[a-z_]+\b")
SERIES_OF_HISTOGRAM = ("_bucket", "_count", "_sum")
ALERT = re.compile(r"- alert: (\w+)\n(.*?)(?=\n\n|\n      - alert|\Z)", re.DOTALL)
ALERTS = dict(ALERT.findall((MONITORING / "rules.yml").read_text()))
QUIET_S = 60


def read_values(exposed: bytes) -> dict[str, float]:
    """Those without labels."""
    samples = [
        each
        for family in text_string_to_metric_families(exposed.decode())
        for each in family.samples
        if not each.labels
    ]
    return {sample.name: sample.value for sample in samples}


def names_in(exposed: str) -> set[str]:
    """As Prometheus has them, of series that have no value yet too."""
    typed = re.findall(r"^# TYPE (\w+) (\w+)$", exposed, re.MULTILINE)
    return {name for name, kind in typed if not name.endswith("_created") for name in series_of(name, kind)}


def series_of(name: str, kind: str) -> set[str]:
    return {name + end for end in SERIES_OF_HISTOGRAM} if kind == "histogram" else {name}


def queries_of_the_dashboard() -> list[str]:
    panels = json.loads((MONITORING / "dashboard.json").read_text())["panels"]
    return [target["expr"] for panel in panels for target in panel["targets"]]


async def test_all_that_is_asked_for_is_exposed_and_documented(tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=find_base_port(1))
    config = Cluster(tmp_path / "network").config("node-1")
    url = f"http://127.0.0.1:{config.operator_port}/metrics"
    async with (
        Node(config),
        aiohttp.ClientSession() as session,
        session.get(url, headers=reading_headers(config)) as answer,
    ):
        exposed = await answer.text()
    names, values = names_in(exposed), read_values(exposed.encode())
    documented = re.findall(r"^\| `(\w+)`", REFERENCE.read_text(), re.MULTILINE)
    histograms = {name.removesuffix("_bucket") for name in names if name.endswith("_bucket")}
    plain = {name for name in names if not name.startswith(tuple(histograms))}
    assert sorted(documented) == sorted(plain | histograms)
    asked = {name for text in (*ALERTS.values(), *queries_of_the_dashboard()) for name in NAME.findall(text)}
    assert len(asked) > 30
    assert asked - names == set()
    certificate = x509.load_pem_x509_certificate(config.tls_certificate_path.read_bytes())
    assert values["blockrobot_certificate_ends_timestamp_seconds"] == certificate.not_valid_after_utc.timestamp()
    assert 0 < values["blockrobot_disk_free_bytes"] < values["blockrobot_disk_size_bytes"]


@in_virtual_time
async def test_margin_and_finality_are_those_of_the_network() -> None:
    crowd = await SmallNodes(make_genesis(["a", "b", "c", "d"], followers=["e"])).start()

    def read() -> dict[str, float]:
        return read_values(crowd.nodes["a"].metrics())

    await crowd.finalize("a", crowd.transaction("identity", "authenticate", bytes(32)))
    well = read()
    assert (well["blockrobot_producers"], well["blockrobot_quorum"], well["blockrobot_producers_in_touch"]) == (4, 3, 4)
    assert (well["blockrobot_finality_late"], well["blockrobot_producers_accused"]) == (0, 0)
    await asyncio.sleep(2 * QUIET_S)
    idle = read()
    assert idle["blockrobot_blocks_finalized_total"] > well["blockrobot_blocks_finalized_total"]
    assert idle["blockrobot_block_to_stored_seconds_count"] == well["blockrobot_block_to_stored_seconds_count"] == 1
    assert (idle["blockrobot_finality_late"], idle["blockrobot_rounds_timed_out_total"]) == (0, 0)
    await crowd.stop("c", "d")
    await asyncio.sleep(QUIET_S)
    ill = read()
    assert ill["blockrobot_producers_in_touch"] == 2
    assert ill["blockrobot_finality_late"] == 1
    assert ill["blockrobot_finality_age_seconds"] >= QUIET_S - 1
    assert "blockrobot_custody_behind_blocks" not in ill, "it is no custodian"
    await crowd.stop()


@in_virtual_time
async def test_who_signed_twice_is_counted_from_the_evidence_on() -> None:
    crowd = await SmallNodes(make_genesis(["a", "b", "c", "d"])).start()
    node, liar, chain_id = crowd.nodes["a"], producer_key("d"), crowd.genesis.chain_id
    index = node.engine.epoch.schedule.producers.index(liar.public_key)
    words = [(block, sign_vote(liar, chain_id, 0, 1, block, index).signature) for block in (b"1" * 32, b"2" * 32)]
    assert node.evidence_submitter is not None
    node.evidence_submitter.note(make_evidence("vote", 0, 1, liar.public_key, *words))
    assert read_values(node.metrics())["blockrobot_producers_accused"] == 1
    await asyncio.sleep(QUIET_S)
    assert read_values(crowd.nodes["b"].metrics())["blockrobot_producers_accused"] == 1, "it is suspended on the chain"
    await crowd.stop()


@pytest.mark.parametrize("alert", ALERTS)
def test_an_alert_tells_the_next_step_and_has_its_test(alert: str) -> None:
    text = " ".join(ALERTS[alert].replace("{{ $labels.node }}", "ward-1").split())
    typed = re.findall(r"`blockrobot ([^`]*)`", text)
    pages = re.findall(r"docs/[\w/-]+\.md", text)
    assert typed or pages
    assert {command: fault for command in typed if (fault := fault_of(command))} == {}
    assert [page for page in pages if not (ROOT / page).exists()] == []
    assert f"- name: {alert}\n" in (MONITORING / "rules_test.yml").read_text()
