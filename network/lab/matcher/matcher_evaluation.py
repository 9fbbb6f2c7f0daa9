"""The matcher's rates of wrong owners and withheld frames, on drawn tracks."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, TypeVar

import numpy as np
from scipy.stats import beta

from clients.robot.hiding.frame_redactor import BUFFER_DEFAULT_MS
from clients.robot.matching.matcher import Matcher
from network.bench.conditions import Result, measure_conditions, percentile
from network.bench.processes import worker_pool
from network.lab.matcher.matcher_draws import FRAME_EVERY_MS, TRACK_MS, Bearer, Drawn, Setting, draw

WRONG_MAX_RATE = 0.001
WITHHELD_MAX_RATE = 0.05
RATES_HZ = (1, 2, 5)
SIGMAS_M = (0.3, 0.5, 0.8)
PEOPLE = (1, 2, 3)
BEARERS: tuple[Bearer, ...] = ("present", "absent", "behind")
# Each group of draws: what it changes of the plain one, and how many tracks it has for each of the plain ones.
GROUPS: dict[str, tuple[dict[str, Any], float]] = {
    "facing": ({}, 1.0),
    "sigma-understated": ({"understated": True}, 1.0),
    "drifting": ({"drifting": True}, 1.0),
    "no-facing": ({"facing": False}, 0.25),
    "no-distance": ({"distance": False}, 0.1),
    "aside": ({"bearer": "aside"}, 0.25),
    # Off what the matcher assumes.
    "weak-fronts": ({"weak_fronts": True}, 0.25),
    "biased": ({"bias_sigma_m": 0.4}, 0.25),
    "drifting-long": ({"drifting": True, "drift_s": 6.0}, 0.25),
    "outliers": ({"outliers": True}, 0.25),
    "ranges-off": ({"ranges_off": True}, 0.25),
    "bearings": ({"bearing_sigma_deg": 9.0}, 0.25),
    "bearings-drifting": ({"bearing_sigma_deg": 9.0, "drifting": True}, 0.25),
    "bearings-off": ({"bearing_sigma_deg": 9.0, "bearings_off": True}, 0.25),
    "bearings-aside": ({"bearing_sigma_deg": 9.0, "bearer": "aside"}, 0.25),
}
_NUMBERED_COUNT = 6
"""The first groups, whose draws are numbered in turn; of later ones each has its own numbers, so that none changes."""
GAPS = ("alone", "over-1m", "half-to-1m", "under-half")
_CHUNK_COUNT = 100
TAGS_COUNT = 3
STORM_COUNT = 10_000


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one draw. `withheld` (share), `bound_at_ms`: None unless bearer in view."""

    group: str
    setting: Setting
    gap: str
    wrong: bool
    withheld: float | None
    bound_at_ms: int | None


Progress = Callable[[int, int], None]
Job = tuple[str, int, int, int]  # group, first draw, end, seed
Told = TypeVar("Told")  # what is told of one draw
Stratum = dict[str, str | float | dict[str, float]]


def play(drawn: Drawn) -> list[tuple[int, int | None]]:
    """Feed a draw to the matcher; return (ms, bound track) per reading."""
    matcher = Matcher()
    for track in drawn.tracks:
        matcher.add_track(track)
    present = [track.number for track in drawn.tracks]
    bound = []
    for reading in drawn.readings:
        matcher.add_sighting("tag", reading)
        matcher.advance(reading.middle_ms)
        bound.append((reading.middle_ms, matcher.bound_track("tag", present)))
    return bound


def judge(group: str, drawn: Drawn) -> Outcome:
    bound = play(drawn)
    wrong = any(number is not None and number != drawn.bearer for _, number in bound)
    right_ms = [at for at, number in bound if number is not None and number == drawn.bearer]
    gap = gap_name(drawn.gap_m)
    if drawn.bearer is None:
        return Outcome(group, drawn.setting, gap, wrong, None, None)
    return Outcome(group, drawn.setting, gap, wrong, _withheld_share(bound, drawn.bearer), min(right_ms, default=None))


def gap_name(gap_m: float) -> str:
    if np.isinf(gap_m):
        return "alone"
    return "over-1m" if gap_m > 1 else "half-to-1m" if gap_m >= 0.5 else "under-half"


def _withheld_share(bound: Sequence[tuple[int, int | None]], bearer: int) -> float:
    frames = np.arange(0, TRACK_MS + 1, FRAME_EVERY_MS)
    released = np.zeros(frames.size, dtype=bool)
    ends = [at for at, _ in bound[1:]] + [TRACK_MS]
    for (at, number), end in zip(bound, ends, strict=True):
        if number == bearer:
            released |= (frames >= at - BUFFER_DEFAULT_MS) & (frames <= end)
    return float(1 - released.mean())


def settings_of(group: str, bearers: Sequence[Bearer] = BEARERS) -> list[Setting]:
    changes, _ = GROUPS[group]
    plain = [Setting(*values) for values in product(RATES_HZ, SIGMAS_M, PEOPLE, bearers)]
    return [replace(setting, **changes) for setting in plain]


def _judge_chunk(job: Job) -> list[Outcome]:
    group, first, end, seed = job
    settings, place = settings_of(group), list(GROUPS).index(group)
    base, stride = (place, _NUMBERED_COUNT) if place < _NUMBERED_COUNT else (place << 32, 1)
    return [judge(group, draw(settings[i % len(settings)], seed, base + i * stride)) for i in range(first, end)]


def judge_all(
    judge_chunk: Callable[[Job], list[Told]],
    counts: Mapping[str, int],
    seed: int,
    *,
    workers: int,
    on: str,
    progress: Progress | None,
) -> list[Told]:
    """Judge so many draws of each group, a hundred at once."""
    jobs = [
        (group, i, min(i + _CHUNK_COUNT, count), seed)
        for group, count in counts.items()
        for i in range(0, count, _CHUNK_COUNT)
    ]
    outcomes: list[Told] = []
    with contextlib.nullcontext() if workers == 1 and not on else worker_pool(workers, on) as pool:
        chunks = map(judge_chunk, jobs) if pool is None else pool.map(judge_chunk, jobs)
        for done, some in enumerate(chunks, start=1):
            outcomes += some
            if progress is not None:
                progress(done, len(jobs))
    return outcomes


class MatcherResult(Result[dict[str, float]], kw_only=True):
    """`strata`: the same for each group, sigma and rate."""

    strata: list[Stratum]


def judge_matcher(
    tracks: int,
    seed: int,
    *,
    workers: int | None = None,
    on: str = "",
    groups: Iterable[str] = tuple(GROUPS),
    progress: Progress | None = None,
) -> MatcherResult:
    """Judge `tracks` tracks in each group with facing (fewer in others); independent of `workers`."""
    workers = workers or len(os.sched_getaffinity(0))
    conditions = measure_conditions(nodes=0, seed=seed, tracks=tracks, workers=on or workers)
    cost = measure_cost(seed)
    counts = {group: max(1, round(tracks * GROUPS[group][1])) for group in groups}
    outcomes = judge_all(_judge_chunk, counts, seed, workers=workers, on=on, progress=progress)
    figures = {**headline(outcomes), **cost}
    ok, rows = meets_goals(figures), strata(outcomes)
    return MatcherResult(name="matcher", ok=ok, figures=figures, conditions=conditions, strata=rows)


def headline(outcomes: Sequence[Outcome]) -> dict[str, float]:
    facing = [o for o in outcomes if o.group == "facing"]
    figures: dict[str, float] = {"tracks": len(outcomes)}
    figures |= _wrong("wrong_owner", facing)
    figures |= _wrong("wrong_absent", [o for o in facing if o.setting.bearer != "present"])
    for group in list(GROUPS)[1:]:
        figures |= _wrong(f"wrong_{group.replace('-', '_')}", [o for o in outcomes if o.group == group])
    close = [o for o in outcomes if o.group == "drifting" and o.gap == "under-half"]
    figures |= _wrong("wrong_drifting_under_half", close)
    easy = [o for o in facing if o.gap == "over-1m" and o.setting.rate_hz >= 2 and o.setting.sigma_m <= 0.5]
    figures |= _withheld("withheld", easy)
    return figures


def meets_goals(figures: Mapping[str, float]) -> bool:
    names = ("wrong_owner", "wrong_absent", "wrong_sigma_understated", "wrong_drifting")
    rates = [figures.get(f"{name}_rate") for name in names]
    withheld = figures.get("withheld_rate")
    return all(rate is None or rate <= WRONG_MAX_RATE for rate in rates) and (
        withheld is None or withheld <= WITHHELD_MAX_RATE
    )


def strata(outcomes: Sequence[Outcome]) -> list[Stratum]:
    rows = []
    for group, sigma_m, rate_hz in product(GROUPS, SIGMAS_M, RATES_HZ):
        mine = [o for o in outcomes if (o.group, o.setting.sigma_m, o.setting.rate_hz) == (group, sigma_m, rate_hz)]
        if not mine:
            continue
        row: Stratum = {"group": group, "sigma_m": sigma_m, "rate_hz": rate_hz, "tracks": len(mine)}
        row |= _wrong("wrong", mine)
        for bearer in BEARERS:
            row[f"bearer_{bearer}"] = _wrong("wrong", [o for o in mine if o.setting.bearer == bearer])
        for gap in GAPS:
            at_gap = [o for o in mine if o.gap == gap]
            row[gap] = {**_wrong("wrong", at_gap), **_withheld("withheld", at_gap), **_delays(at_gap)}
        rows.append(row)
    return rows


def upper_bound(wrong: int, count: int) -> float:
    """Return a rate's one-sided upper 95 % bound (Clopper-Pearson)."""
    return 1.0 if wrong >= count else float(beta.ppf(0.95, wrong + 1, count - wrong))


def _wrong(name: str, outcomes: Sequence[Outcome]) -> dict[str, float]:
    return wrong_figures(name, [outcome.wrong for outcome in outcomes])


def wrong_figures(name: str, wrong: Sequence[bool]) -> dict[str, float]:
    """Nothing if there is nothing to count."""
    if not wrong:
        return {}
    return {
        f"{name}_rate": round(sum(wrong) / len(wrong), 6),
        f"{name}_count": sum(wrong),
        f"{name}_of": len(wrong),
        f"{name}_upper95": round(upper_bound(sum(wrong), len(wrong)), 6),
    }


def _withheld(name: str, outcomes: Sequence[Outcome]) -> dict[str, float]:
    shares = np.array([o.withheld for o in outcomes if o.withheld is not None])
    if shares.size == 0:
        return {}
    error = float(shares.std() / np.sqrt(shares.size))
    return {
        f"{name}_rate": round(float(shares.mean()), 5),
        f"{name}_of": int(shares.size),
        f"{name}_upper95": round(min(1.0, float(shares.mean()) + 1.645 * error), 5),
    }


def _delays(outcomes: Sequence[Outcome]) -> dict[str, float]:
    present = [o for o in outcomes if o.withheld is not None]
    bound = [float(o.bound_at_ms) for o in present if o.bound_at_ms is not None]
    if not present:
        return {}
    return {
        "never_bound_rate": round(1 - len(bound) / len(present), 5),
        "bound_after_p50_ms": percentile(bound, 0.5),
        "bound_after_p90_ms": percentile(bound, 0.9),
    }


def measure_cost(seed: int) -> dict[str, float]:
    """CPU times with three people and tags, and of a storm."""
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
