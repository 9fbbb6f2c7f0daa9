"""What became of every frame: covered = kept + withheld + lost, and nothing is kept before it is final."""

from __future__ import annotations

import numpy as np
import pytest

from clients.robot.recording.frame_answers import Latency
from clients.robot.recording.run_statistics import ARRIVALS_MAX_COUNT, Distribution, RunStatistics
from clients.robot.recording.spool import Delivered
from tests.unit.clients.robot.test_spool import clip


def deliver(statistics: RunStatistics, number: int, final_at_ms: int) -> None:
    statistics.delivered(Delivered(clip(number, size_bytes=100), bytes(32), final_at_ms - 50, final_at_ms))


def test_a_frame_counts_as_kept_only_when_its_record_is_final() -> None:
    statistics = RunStatistics(window_ms=5_000, covered=2)
    statistics.frame_arrived(1, 1_010)
    statistics.frame_arrived(2, 1_110)
    statistics.clip_sealed((7).to_bytes(16, "big"), [(1, 1_000), (2, 1_100)])
    assert statistics.count_frames().kept == 0
    assert statistics.count_frames().lost == 2
    deliver(statistics, 7, 7_000)
    counts = statistics.count_frames()
    assert (counts.kept, counts.lost, statistics.records_final) == (2, 0, 1)


def test_withheld_frames_are_not_lost_and_a_summary_of_nothing_is_zero() -> None:
    statistics = RunStatistics(window_ms=5_000, covered=5, withheld={"contact": 2, "ambiguous": 3})
    counts = statistics.count_frames()
    assert (counts.withheld, counts.lost) == (5, 0)
    assert list(counts.withheld_reasons) == ["ambiguous", "contact"]
    assert Distribution().summarise() == Latency(p50=0.0, p95=0.0, max=0.0)
    assert filled(list(range(101))).summarise() == Latency(p50=50.0, p95=95.0, max=100.0)


def test_latencies_are_measured_from_what_they_say() -> None:
    """From the end of the pairing window, from the frame's arrival, and from the submission."""
    statistics = RunStatistics(window_ms=5_000, covered=1)
    statistics.frame_arrived(1, 1_010)
    statistics.clip_sealed((7).to_bytes(16, "big"), [(1, 1_000)])
    deliver(statistics, 7, 6_300)
    latency = statistics.summarise_latencies()
    assert latency.frame_to_final.p50 == 300.0
    assert latency.arrival_to_final.p50 == 5_290.0
    assert latency.submit_to_final.max == 50.0


def test_how_long_a_frame_took_counts_from_when_it_was_decided() -> None:
    """Of what was decided and dropped afterwards nothing is counted."""
    statistics = RunStatistics(window_ms=5_000, covered=3)
    for sequence in (1, 2, 3):
        statistics.frame_arrived(sequence, 1_000)
        statistics.frame_decided("tag-a", sequence, 6_000 + 100 * sequence)
    statistics.forget_decided("tag-a", 3)
    statistics.clip_sealed((7).to_bytes(16, "big"), [(1, 1_000), (2, 1_033), (3, 1_066)], "tag-a")
    deliver(statistics, 7, 6_400)
    assert statistics.decided_to_final.counts == {300: 1, 200: 1}
    assert statistics.summarise_latencies().decided_to_final.max == 300.0


def test_a_clip_of_the_run_before_is_no_frame_of_this_run_and_stored_bytes_are_those_of_ciphertexts() -> None:
    statistics = RunStatistics(window_ms=5_000)
    deliver(statistics, 3, 2_000)
    counts = statistics.count_frames()
    assert (statistics.records_final, counts.kept, counts.lost) == (1, 0, 0)
    statistics = RunStatistics(window_ms=5_000)
    deliver(statistics, 1, 2_000)
    deliver(statistics, 2, 3_000)
    assert statistics.stored_bytes == 200


def filled(values: list[int]) -> Distribution:
    distribution = Distribution()
    for value in values:
        distribution.add(value)
    return distribution


@pytest.mark.parametrize("values", [[7], [3, 9], [5, 5, 5, 1], [-40, 12, 900, 12, 9_999], [1, 2, 3, 4, 100, 100]])
def test_percentiles_are_those_of_all_values(values: list[int]) -> None:
    told = filled(values).summarise()
    assert told.p50 == round(float(np.percentile(values, 50)), 1)
    assert told.p95 == round(float(np.percentile(values, 95)), 1)
    assert told.max == max(values)


def test_what_takes_some_milliseconds_is_told_to_a_tenth() -> None:
    distribution = Distribution(per_ms=10)
    for value_ms in (7.26, 7.34, 12.04, 2_000.0):
        distribution.add(value_ms)
    assert distribution.summarise() == Latency(p50=9.7, p95=1_701.8, max=2_000.0)


def test_a_run_of_weeks_takes_no_more_memory_than_one_of_minutes() -> None:
    """Long times are told to four digits, so that there are not many different ones."""
    assert filled([59_876, 612_345]).counts == {59_870: 1, 612_300: 1}
    assert len(filled(list(range(0, 1_000_000, 7))).counts) < 30_000
    statistics = RunStatistics(window_ms=5_000)
    for sequence in range(ARRIVALS_MAX_COUNT + 50):
        statistics.frame_arrived(sequence, 1_000 + sequence)
    assert len(statistics.arrivals_ms) == ARRIVALS_MAX_COUNT
    assert min(statistics.arrivals_ms) == 50


def test_a_frame_whose_arrival_is_forgotten_is_kept_all_the_same() -> None:
    statistics = RunStatistics(window_ms=5_000, covered=1)
    statistics.clip_sealed((7).to_bytes(16, "big"), [(1, 1_000)])
    deliver(statistics, 7, 6_300)
    assert statistics.count_frames().kept == 1
    assert statistics.summarise_latencies().arrival_to_final.max == 0.0


def test_the_longest_time_between_two_finals_is_known() -> None:
    statistics = RunStatistics(window_ms=5_000)
    deliver(statistics, 1, 2_000)
    assert statistics.final_gap_max_ms == 0
    for number, final_at_ms in ((2, 2_100), (3, 5_200), (4, 5_300)):
        deliver(statistics, number, final_at_ms)
    assert statistics.final_gap_max_ms == 3_100
