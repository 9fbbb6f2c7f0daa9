"""Puts a whole run together: recording, roster, pipeline, delivery, and the summary of what became of every frame."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2

from clients.robot.delivery import Delivered, Delivery
from clients.robot.event_log import EventLog
from clients.robot.events import Event
from clients.robot.hiding.background import empty_bank, learn_background
from clients.robot.hiding.hider import Hider
from clients.robot.identity import load_identity
from clients.robot.network import RobotNetwork
from clients.robot.pipeline import Camera, Pipeline
from clients.robot.rosters import load_roster
from clients.robot.source import BagSource
from clients.robot.spool import Spool
from clients.robot.statistics import RunStatistics
from clients.robot.visits import VisitBook
from clients.sdk.http import NetworkClient
from consensus.genesis import Genesis

SENSOR_NAME = "depth"
EMPTY_FRAMES_KEPT_COUNT = 8
_START_DELAY_MS = 250


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """How to replay: where the roster is, for what purpose, how long a clip is, where events go."""

    roster: Path
    purpose: str
    clip_ms: int
    events: Path
    at_once: bool
    real_time: bool


class ProgressListener(Protocol):
    """Is told how far the run is."""

    def __call__(self, figures: dict[str, Any], *, last: bool = False) -> None:
        """Take frames_read, frames_recorded and waiting."""


async def _events(source: BagSource, *, real_time: bool) -> AsyncIterator[Event]:
    if real_time:
        async for event in source.play():
            yield event
    else:
        for event in source.events():
            yield event


async def replay_recording(
    folder: Path, recording: Path, genesis: Genesis, options: ReplayOptions, progress: ProgressListener
) -> dict[str, Any]:
    """Replay a recording through the robot in `folder` and return its summary once all its records are final.

    Raises BAG_*, ROSTER_*, SPOOL_*, and what the network refuses for good.
    """
    # Picture work runs in one thread beside the nodes; a pool of OpenCV's own would only fight them for cores.
    cv2.setNumThreads(1)
    identity = load_identity(folder)
    source = BagSource(recording)
    empty = source.empty_frames()
    async with NetworkClient(genesis) as client:
        network = RobotNetwork(client, identity)
        roster = load_roster(options.roster, identity, genesis, network.now_ms())
        bank = tuple(empty_bank(empty)[:EMPTY_FRAMES_KEPT_COUNT])
        hider = Hider(learn_background(empty))
        statistics = RunStatistics(window_ms=hider.pairing.window_ms)
        spool = Spool(folder / "spool", identity.spool)
        await network.publish_empty_frames(bank)
        height, width = empty[0].shape
        with EventLog(options.events) as log:
            delivery = Delivery(
                spool,
                network,
                on_delivered=lambda done: delivered(done),  # noqa: PLW0108 - bound below
                at_once=options.at_once,
            )
            pipeline = Pipeline(
                camera=Camera(sensor=SENSOR_NAME, width=width, height=height, empty_frames=bank),
                hider=hider,
                roster=roster,
                visits=VisitBook(genesis.chain_id, identity.identity.public_key, options.purpose),
                spool=spool,
                delivery=delivery,
                statistics=statistics,
                log=log,
                purpose=options.purpose,
                clip_ms=options.clip_ms,
                now_ms=network.now_ms,
            )

            def delivered(done: Delivered) -> None:
                pipeline.note_delivered(done)
                tell()

            def tell(*, last: bool = False) -> None:
                figures = {
                    "frames_read": statistics.published,
                    "frames_recorded": statistics.kept_final,
                    "records": statistics.records_final,
                    "waiting": len(spool.names()),
                }
                progress(figures, last=last)

            async def watched(events: AsyncIterator[Event]) -> AsyncIterator[Event]:
                async for event in events:
                    tell()
                    yield event

            source.shift_to(network.now_ms() + _START_DELAY_MS)
            try:
                await pipeline.run(watched(_events(source, real_time=options.real_time)))
            finally:
                await delivery.stop()
            tell(last=True)
    return {
        "frames": statistics.frames_json(),
        "latency_ms": statistics.latency_json(),
        "records": statistics.records_final,
        "stored_bytes": statistics.stored_bytes,
        "final_gap_max_s": _longest_gap_s(statistics.final_times_ms),
    }


def _longest_gap_s(times_ms: list[int]) -> float:
    """Return the longest time between two records that became final, in seconds."""
    ordered = sorted(times_ms)
    gaps = [later - earlier for earlier, later in itertools.pairwise(ordered)]
    return round(max(gaps, default=0) / 1000, 3)
