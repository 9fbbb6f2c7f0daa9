"""The matcher's CPU time per frame and reading, normally and in a storm."""

from __future__ import annotations

import time
from dataclasses import replace

from clients.robot.hiding.matcher import Matcher
from network.bench.conditions import percentile
from network.lab.matcher.matcher_draws import FRAME_EVERY_MS, TRACK_MS, Setting, draw

TAGS_COUNT = 3
STORM_COUNT = 10_000


def measure_cost(seed: int) -> dict[str, float]:
    """Return CPU times with three people and tags, and of a storm."""
    drawn = [draw(Setting(5, 0.3, 3, "present"), seed, number) for number in range(TAGS_COUNT)]
    matcher, waiting = Matcher(), []
    for track in drawn[0].tracks:
        matcher.add_track(track)
    for number, one in enumerate(drawn):
        waiting += [(reading, f"tag-{number}") for reading in one.readings]
    waiting.sort(key=lambda item: item[0].middle_ms, reverse=True)
    count, frames_ms = len(waiting), []
    for at_ms in range(0, TRACK_MS + 1, FRAME_EVERY_MS):
        began = time.thread_time()
        while waiting and waiting[-1][0].middle_ms <= at_ms:
            reading, alias = waiting.pop()
            matcher.add_sighting(alias, reading)
        matcher.advance(at_ms)
        frames_ms.append(1000 * (time.thread_time() - began))
    return {
        "matcher_frame_ms": round(sum(frames_ms) / len(frames_ms), 3),
        "matcher_frame_p95_ms": round(percentile(frames_ms, 0.95), 3),
        "matcher_reading_us": round(1000 * sum(frames_ms) / count, 1),
        **_measure_storm(seed),
    }


def _measure_storm(seed: int) -> dict[str, float]:
    one = draw(Setting(5, 0.3, 3, "present"), seed, 0)
    matcher = Matcher()
    for track in one.tracks:
        matcher.add_track(track)
    first = one.readings[0]
    storm = [replace(first, first_seen_ms=i // 10, last_seen_ms=i // 10, antenna=i % 4) for i in range(STORM_COUNT)]
    began = time.thread_time()
    for reading in storm:
        matcher.add_sighting("tag", reading)
    taken = time.thread_time()
    matcher.advance(1_000)
    ended = time.thread_time()
    return {
        "storm_reading_us": round(1e6 * (taken - began) / STORM_COUNT, 2),
        "storm_frame_ms": round(1000 * (ended - taken), 2),
        "storm_held": matcher.held_count,
    }
