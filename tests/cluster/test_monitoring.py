"""A real Prometheus reads a network that runs, by the configuration, rules and dashboard that an operator is given."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import aiohttp
import pytest
import pytest_asyncio
import yaml

from network.bench.custody.custody_clips import ClipRobot
from network.bench.fresh_network import FreshNetwork
from node.config import CONFIG_FILE, READING_TOKEN_FILE_NAME
from tests.cluster.network_under_test import find_base_port
from tests.unit.node.test_metrics import ALERTS, MONITORING, NAME, queries_of_the_dashboard

METRICS_PORT_OFFSET = 3
WAIT_MAX_S = 90
INTERVAL = "2s"
FOR = "6s"
STRANGER = "stranger"
OF_A_SLOW_MACHINE = ("BlockRobotFinalitySlow", "BlockRobotRoundsTimeOut")
"""Alerts that may be right where tests run beside much other work."""
EMPTY_WHERE_ALL_IS_WELL = {'blockrobot_uploads_refused{node=~"$node"} > 0'}
pytestmark = [
    pytest.mark.system_packages,
    pytest.mark.timeout(300),
    pytest.mark.asyncio(loop_scope="module"),
]


def promtool(*arguments: str) -> None:
    done = subprocess.run(["promtool", *arguments], cwd=MONITORING, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


class Watched:
    """A network, and the Prometheus that reads it."""

    def __init__(self, network: FreshNetwork, url: str, http: aiohttp.ClientSession) -> None:
        self.cluster = network.cluster
        self._url, self._http = url, http

    async def ask(self, path: str, **parameters: str) -> Any:
        async with self._http.get(f"{self._url}/api/v1/{path}", params=parameters) as answer:
            told = await answer.json()
            assert told["status"] == "success", (parameters, told)
            return told["data"]

    async def query(self, expression: str) -> list[Any]:
        """As Grafana would fill it in."""
        filled = expression.replace("$__rate_interval", "2m").replace("$node", ".*")
        return (await self.ask("query", query=filled))["result"]

    async def alerts(self) -> dict[tuple[str, str], Any]:
        told = (await self.ask("alerts"))["alerts"]
        by_place = {(each["labels"]["alertname"], each["labels"].get("node", "")): each for each in told}
        return {place: each for place, each in by_place.items() if place[0] not in OF_A_SLOW_MACHINE}


def make_configuration(folder: Path, network: FreshNetwork) -> None:
    """The shipped files with this network's nodes in place of the example's, and shorter times."""
    rules, ends_count = re.subn(r"for: \d+[mh]", f"for: {FOR}", (MONITORING / "rules.yml").read_text())
    assert ends_count > 10
    (folder / "rules.yml").write_text(rules)
    authorities = [organisation.ca_certificate for organisation in network.genesis.organisations]
    (folder / "ca.crt.pem").write_text("".join(authorities))
    made = yaml.safe_load((MONITORING / "prometheus.yml").read_text())
    made["global"] = dict.fromkeys(made["global"], INTERVAL)
    del made["alerting"]
    example, jobs = made["scrape_configs"][0], []
    for name, config in network.cluster.configs.items():
        token = folder / f"{name}.token"
        shutil.copy(config.data_dir / READING_TOKEN_FILE_NAME, token)
        jobs.append(_job_of(example, name, config.p2p_port + METRICS_PORT_OFFSET, token))
    (folder / "wrong.token").write_text("no token of any node")
    stranger = _job_of(example, STRANGER, config.p2p_port + METRICS_PORT_OFFSET, folder / "wrong.token")
    stranger["static_configs"][0]["labels"] = {"job": STRANGER}
    (folder / "prometheus.yml").write_text(json.dumps(made | {"scrape_configs": [*jobs, stranger]}))


def _job_of(example: dict[str, Any], name: str, port: int, token: Path) -> dict[str, Any]:
    job = json.loads(json.dumps(example))
    job["job_name"] = name
    job["tls_config"]["ca_file"] = str(token.parent / "ca.crt.pem")
    job["authorization"]["credentials_file"] = str(token)
    job["static_configs"] = [{"targets": [f"127.0.0.1:{port}"], "labels": {"job": "blockrobot", "node": name}}]
    return job


async def open_metrics_ports(network: FreshNetwork) -> None:
    """At all addresses, so that they are served over TLS as between hosts."""
    await asyncio.to_thread(network.cluster.stop_all)
    for config in network.cluster.configs.values():
        port = config.p2p_port + METRICS_PORT_OFFSET
        with (config.data_dir / CONFIG_FILE).open("a") as file:
            file.write(f'\n[metrics]\nhost = "0.0.0.0"\nport = {port}\n')
    network.cluster.start_all()
    await network.cluster.wait_ready()


@contextmanager
def running_prometheus(folder: Path) -> Iterator[str]:
    address = f"127.0.0.1:{find_base_port(1)}"
    command = ["prometheus", "--config.file=prometheus.yml", "--storage.tsdb.path=data", "--log.level=warn"]
    with (
        (folder / "prometheus.log").open("wb") as log,
        subprocess.Popen([*command, f"--web.listen-address={address}"], cwd=folder, stdout=log, stderr=log) as process,
    ):
        try:
            yield f"http://{address}"
        finally:
            process.terminate()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def watched(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Watched]:
    """Four nodes, two of them custodians; a robot has uploaded two clips, and one is erased."""
    folder = tmp_path_factory.mktemp("prometheus")
    async with FreshNetwork(4) as network:
        await open_metrics_ports(network)
        (enrolled,) = await network.enrol_robots(1)
        robot = ClipRobot(enrolled.key, network.open_client())
        owner = await robot.open_visit()
        erased, _ = [await robot.record(owner, 2, 2_000) for _ in range(2)]
        await robot.wait_erased(owner, await robot.request_erasure(owner, [erased.record_id]))
        make_configuration(folder, network)
        promtool("check", "config", str(folder / "prometheus.yml"))
        with running_prometheus(folder) as url:
            async with aiohttp.ClientSession() as http:
                watched = Watched(network, url, http)
                await eventually(lambda: _has_read_all(watched))
                yield watched


async def eventually(holds: Any) -> None:
    deadline_s = time.monotonic() + WAIT_MAX_S
    while not await holds():
        assert time.monotonic() < deadline_s, "it did not come about"
        await asyncio.sleep(0.5)


async def _has_read_all(watched: Watched) -> bool:
    try:
        counts = await watched.query("count_over_time(blockrobot_finalized_height[2m])")
    except aiohttp.ClientError:
        return False
    return len(counts) == len(watched.cluster.names) and all(int(row["value"][1]) > 3 for row in counts)


async def test_promtool_finds_nothing_wrong_with_what_is_shipped_and_each_alert_fires_when_it_has_to() -> None:
    promtool("check", "config", "--syntax-only", "prometheus.yml")
    promtool("check", "rules", "rules.yml")
    promtool("test", "rules", "rules_test.yml")


async def test_nodes_are_read_over_tls_by_who_shows_their_token_and_by_nobody_else(watched: Watched) -> None:
    targets = (await watched.ask("targets"))["activeTargets"]
    told = {target["scrapePool"]: (target["health"], target["lastError"]) for target in targets}
    refused = told.pop(STRANGER)
    assert told == dict.fromkeys(watched.cluster.names, ("up", ""))
    assert refused[0] == "down"
    assert "401" in refused[1]
    assert all(target["scrapeUrl"].startswith("https://") for target in targets)


async def test_every_metric_that_alerts_and_dashboard_name_has_a_value(watched: Watched) -> None:
    asked = {name for text in (*ALERTS.values(), *queries_of_the_dashboard()) for name in NAME.findall(text)}
    assert asked - set(await watched.ask("label/__name__/values")) == set()


async def test_every_query_of_the_dashboard_and_every_rule_runs(watched: Watched) -> None:
    for expression in queries_of_the_dashboard():
        assert bool(await watched.query(expression)) == (expression not in EMPTY_WHERE_ALL_IS_WELL), expression
    rules = [rule for group in (await watched.ask("rules"))["groups"] for rule in group["rules"]]
    assert {rule["name"]: rule["health"] for rule in rules} == dict.fromkeys(ALERTS, "ok")


async def test_a_node_that_is_killed_is_told_of_and_so_is_the_margin_that_is_gone(watched: Watched) -> None:
    assert await watched.alerts() == {}
    watched.cluster.kill("node-3")
    seen: list[str] = []

    async def fires() -> bool:
        alerts = await watched.alerts()
        assert all(node == "node-3" for name, node in alerts if name == "BlockRobotNodeDown")
        down = alerts.get(("BlockRobotNodeDown", "node-3"))
        if down is not None and down["state"] not in seen:
            seen.append(down["state"])
            assert down["annotations"]["summary"] == "node-3 does not answer"
        margins = {node for name, node in alerts if name == "BlockRobotNoMargin"}
        return seen[-1:] == ["firing"] and margins == {"node-1", "node-2", "node-4"}

    await eventually(fires)
    assert seen == ["pending", "firing"]
    watched.cluster.start("node-3")

    async def is_well() -> bool:
        return await watched.alerts() == {}

    await eventually(is_well)
