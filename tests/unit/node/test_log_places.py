"""A node's log is JSON, a line each, in its folder or on standard output, where orchestrators look."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import structlog

from network.cluster import Cluster
from network.provisioning.network_layout import create_network
from node.main import configure_logging


@pytest.fixture(autouse=True)
def loggers_as_before() -> Iterator[None]:
    root, before = logging.getLogger(), structlog.get_config()
    handlers, level = list(root.handlers), root.level
    yield
    structlog.configure(**before)
    for handler in set(root.handlers) - set(handlers):
        handler.close()
    root.handlers[:], root.level = handlers, level


@pytest.mark.parametrize(("to", "is_in_file", "is_shown"), [("file", 1, 0), ("stdout", 0, 1), ("both", 1, 1)])
def test_the_log_goes_where_it_is_to_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], to: str, is_in_file: int, is_shown: int
) -> None:
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=20_000)
    config = replace(Cluster(tmp_path / "network").config("node-1"), log_to=to)
    configure_logging(config)
    structlog.get_logger("node.test").warning("disk_low", free_mib=3)
    shown = capsys.readouterr().out.splitlines()
    kept = config.log_path.read_text().splitlines() if config.log_path.exists() else []
    assert (len(kept), len(shown)) == (is_in_file, is_shown)
    for line in (*kept, *shown):
        said = json.loads(line)
        assert (said["event"], said["free_mib"], said["level"]) == ("disk_low", 3, "warning")
