"""The benchmark of blocks through a worker executes real records."""

from __future__ import annotations

import asyncio
from pathlib import Path

from network.bench.vm.worker_blocks import BlockBench


def test_the_benchmark_executes_full_blocks(tmp_path: Path) -> None:
    calls, spent_s = asyncio.run(BlockBench(tmp_path / "ledger").run(0.02))
    assert calls >= 50
    assert 0 < spent_s / calls < 0.01
