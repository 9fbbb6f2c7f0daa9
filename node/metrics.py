"""The node's metrics in the Prometheus text format."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from consensus.chain.block import FinalityProof
from node.execution.block_executor import ExecutedBlock
from node.storage.ledger_store import Position

_LATENCY_BUCKETS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


Figures = Mapping[str, tuple[str, Callable[[], float]]]
"""Figures that are read when asked for, by name: each with its description. What only grows is named `_total`."""


class _Figures(Collector):
    """Counters and gauges that are read when asked for."""

    def __init__(self, figures: Figures) -> None:
        self._figures = figures

    def collect(self) -> Iterator[Metric]:
        for name, (description, read) in self._figures.items():
            family = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
            yield family(name, description, value=read())


class ProcessMetrics:
    """What the node's process and its disk take; the process is told of on Linux alone."""

    def __init__(self, figures: Figures) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(_Figures(figures))
        ProcessCollector(registry=self._registry)

    def render(self) -> bytes:
        return generate_latest(self._registry)


class NodeMetrics:
    """Counters that grow with the chain, and figures read when asked for."""

    def __init__(self, figures: Figures, clock: Callable[[], int]) -> None:
        self._registry = CollectorRegistry()
        self._clock = clock
        self._blocks = Counter("blockrobot_blocks_finalized", "Blocks finalized.", registry=self._registry)
        self._transactions = Counter(
            "blockrobot_transactions_finalized", "Transactions finalized.", registry=self._registry
        )
        self._failed = Counter(
            "blockrobot_transactions_failed", "Finalized transactions whose call failed.", registry=self._registry
        )
        self._gas = Counter("blockrobot_gas_used", "Gas used by finalized blocks.", registry=self._registry)
        self._delay = Histogram(
            "blockrobot_block_to_stored_seconds",
            "Time from a block's timestamp until it was stored here, of blocks with transactions.",
            buckets=_LATENCY_BUCKETS_S,
            registry=self._registry,
        )
        self._registry.register(_Figures(figures))

    def note_finalized(self, blocks: list[ExecutedBlock], _proof: FinalityProof, _position: Position) -> None:
        now_ms = self._clock()
        for block in blocks:
            self._blocks.inc()
            self._transactions.inc(len(block.receipts))
            self._failed.inc(sum(not receipt.ok for receipt in block.receipts))
            self._gas.inc(block.header.gas_used)
            if block.receipts:  # an empty one waits for the next heartbeat, and nobody for it
                self._delay.observe(max(0, now_ms - block.header.timestamp_ms) / 1000)

    def render(self) -> bytes:
        return generate_latest(self._registry)
