"""Where a measurement keeps clips apart, nothing of it is left, whatever ends it."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.bench.clips_apart import ClipsApart, removed_after
from network.bench.custody.custody_bench import CustodyOptions, run_custody_benchmark
from network.bench.fresh_network import FreshNetwork
from network.cli.measure.bench_commands import bench


class BucketOfNobody(ClipsApart):
    async def remove(self, folder: Path) -> None:
        raise BlockRobotError("STORE_UNAVAILABLE", "No S3 server answers.")


NOBODY = BucketOfNobody("s3://bucket")


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


async def begin_network() -> None:
    async with FreshNetwork(1, store="neither", apart=NOBODY):
        raise AssertionError("it does not begin")


@pytest.mark.parametrize(
    "begin", [begin_network, lambda: run_custody_benchmark(CustodyOptions("neither", apart=NOBODY))]
)
def test_a_bucket_that_does_not_answer_neither_hides_what_failed_nor_keeps_the_folder(
    begin: Callable[[], Coroutine[Any, Any, object]], temporary: Path
) -> None:
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID"):
        asyncio.run(begin())
    assert list(temporary.iterdir()) == []


def test_a_bucket_that_does_not_answer_is_told_if_all_else_went_well(temporary: Path) -> None:
    async def measure() -> None:
        async with removed_after(Path(tempfile.mkdtemp()), NOBODY):
            pass

    with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE"):
        asyncio.run(measure())
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("place", ["folder:/srv/clips", "folder:clips", "s3:bucket", "gs://bucket", "/srv/clips"])
def test_clips_are_kept_apart_only_where_they_are_deleted_from(place: str) -> None:
    said = CliRunner().invoke(bench, ["custody", "--clips", place, "--json"])
    assert "CONFIGURATION_INVALID" in said.stdout
