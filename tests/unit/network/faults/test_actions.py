"""What a person writes becomes one action that says what it does, or is refused with what is wrong."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from consensus.errors import BlockRobotError
from network.faults.actions import (
    LINK_PROFILES,
    ActionReader,
    FillDisk,
    GoByzantine,
    Heal,
    Kill,
    Partition,
    SetLink,
    Skew,
    format_duration,
    make_link_fault,
    read_duration,
)
from node.p2p.link_faults import SOUND, LinkFault

READER = ActionReader(("node-1", "node-2", "node-3", "node-4"))


@pytest.mark.parametrize(
    ("text", "groups"),
    [
        ("node-1,node-2 | node-3,node-4", (("node-1", "node-2"), ("node-3", "node-4"))),
        ("node-4", (("node-4",), ("node-1", "node-2", "node-3"))),
        (" node-1 |node-2| node-3 ", (("node-1",), ("node-2",), ("node-3",), ("node-4",))),
    ],
)
def test_groups_are_read_and_who_is_not_named_makes_one_more(text: str, groups: tuple[tuple[str, ...], ...]) -> None:
    assert READER.partition(text) == Partition(groups)


@pytest.mark.parametrize(
    ("text", "link"),
    [
        ("node-1 -> node-2", SetLink("node-1", "node-2", LinkFault(cut=True))),
        ("node-1->node-2", SetLink("node-1", "node-2", LinkFault(cut=True))),
        ("node-1 <-> node-2", SetLink("node-1", "node-2", LinkFault(cut=True), is_both=True)),
    ],
)
def test_a_link_has_one_direction_or_both(text: str, link: SetLink) -> None:
    assert READER.link(text, LinkFault(cut=True)) == link


@pytest.mark.parametrize(
    ("read", "code"),
    [
        (lambda: READER.node("node-5"), "FAULT_UNKNOWN"),
        (lambda: READER.partition("node-1,node-1 | node-2"), "FAULT_INVALID"),
        (lambda: READER.partition("node-1,node-2,node-3,node-4"), "FAULT_INVALID"),
        (lambda: READER.partition("node-1 | "), "FAULT_UNKNOWN"),
        (lambda: READER.link("node-1 - node-2", SOUND), "FAULT_INVALID"),
        (lambda: READER.link("node-1 -> node-1", SOUND), "FAULT_INVALID"),
        (lambda: READER.link("node-1 -> node-9", SOUND), "FAULT_UNKNOWN"),
        (lambda: READER.skew("node-1", "an hour"), "FAULT_INVALID"),
        (lambda: READER.skew("node-1", "+9999d"), "FAULT_INVALID"),
        (lambda: READER.disk("node-1", "floppy", is_full=True), "FAULT_UNKNOWN"),
        (lambda: READER.byzantine("node-1", "rude", 0), "FAULT_UNKNOWN"),
        (lambda: make_link_fault(profile="moon"), "FAULT_UNKNOWN"),
        (lambda: make_link_fault(loss=1.5), "FAULT_INVALID"),
        (lambda: make_link_fault(bandwidth_kbytes_per_s=-1), "FAULT_INVALID"),
    ],
)
def test_what_makes_no_sense_is_refused(read: Callable[[], object], code: str) -> None:
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        read()


@pytest.mark.parametrize(
    ("text", "duration_ms"),
    [
        ("250ms", 250),
        ("2s", 2_000),
        ("1.5s", 1_500),
        ("-90s", -90_000),
        ("+1h30m", 5_400_000),
        ("5min", 300_000),
        ("2d", 172_800_000),
    ],
)
def test_durations_are_read_as_people_write_them(text: str, duration_ms: int) -> None:
    assert read_duration(text) == duration_ms
    assert read_duration(format_duration(duration_ms)) == duration_ms


@pytest.mark.parametrize("text", ["", "5", "s", "5 s", "1h-5m", "--5s", "5sm", "1e3s"])
def test_what_is_no_duration_is_refused(text: str) -> None:
    with pytest.raises(BlockRobotError):
        read_duration(text)


def test_figures_stand_in_the_place_of_a_profiles_which_is_a_sick_but_living_link() -> None:
    fault = make_link_fault(profile="wan", delay_ms=200)
    assert (fault.delay_ms, fault.jitter_ms, fault.loss) == (200, 10, 0.001)
    assert make_link_fault(bandwidth_kbytes_per_s=100).bandwidth_bytes_per_s == 100_000
    assert make_link_fault() == SOUND
    for profile in LINK_PROFILES.values():
        profile.fault.check()
        assert not profile.fault.is_sound
        assert not profile.fault.cut
        assert profile.meaning


def test_every_action_says_what_it_does() -> None:
    said = [
        Kill("node-1").describe(),
        READER.partition("node-4").describe(),
        Partition((READER.names,)).describe(),  # type: ignore[arg-type]
        Heal().describe(),
        Heal(("node-2",)).describe(),
        READER.link("node-1 <-> node-2", LinkFault(delay_ms=5)).describe(),
        Skew("node-1", -90_000).describe(),
        FillDisk("node-1", "ledger").describe(),
        FillDisk("node-1", "ledger", is_full=False).describe(),
        GoByzantine("node-1", "garbage", 4).describe(),
    ]
    assert said == [
        "kill node-1",
        "partition node-4 | node-1, node-2, node-3",
        "join node-1, node-2, node-3, node-4",
        "heal everything",
        "heal node-2",
        "link node-1 <-> node-2: 5 ms",
        "skew node-1 by -1m30s",
        "disk of node-1 under its ledger: full",
        "disk of node-1 under its ledger: free again",
        "byzantine node-1: garbage (seed 4)",
    ]
