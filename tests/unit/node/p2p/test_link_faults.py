"""A sick link delays, loses, narrows and cuts as it was told, in order, and the same way for the same seed."""

from __future__ import annotations

import asyncio

import msgspec
import pytest

from consensus.errors import BlockRobotError
from node.p2p.link_faults import QUEUE_MAX_BYTES, LinkFault, LinkFaultShaper
from node.p2p.wire import FrameKind, encode_frame
from tests.virtual_time import in_virtual_time

VOTE = encode_frame(FrameKind.VOTE, b"v" * 95)
HELLO = encode_frame(FrameKind.HELLO, b"hello")


def numbered(number: int) -> bytes:
    return encode_frame(FrameKind.VOTE, number.to_bytes(4, "big"))


async def carry(shaper: LinkFaultShaper, frames: list[bytes], apart_s: float = 0.0) -> list[tuple[float, bytes]]:
    """Send frames to one peer and return (seconds from the start, frame) of what arrived."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    arrived: list[tuple[float, bytes]] = []
    for frame in frames:
        shaper.deliver("node-2", frame, lambda data: arrived.append((loop.time() - started, data)))
        await asyncio.sleep(apart_s)
    await asyncio.sleep(120)
    return arrived


@in_virtual_time
async def test_a_sound_link_sends_at_once_and_bandwidth_lets_frames_through_one_after_another() -> None:
    assert await carry(LinkFaultShaper("node-1"), [VOTE]) == [(0.0, VOTE)]
    shaper = LinkFaultShaper("node-1")
    shaper.set_link("node-2", LinkFault(bandwidth_bytes_per_s=1_000))
    arrived = await carry(shaper, [VOTE] * 5)
    assert [round(at, 3) for at, _ in arrived] == [0.1, 0.2, 0.3, 0.4, 0.5]


@in_virtual_time
async def test_a_delay_is_waited_and_jitter_never_changes_the_order() -> None:
    shaper = LinkFaultShaper("node-1", seed=3)
    shaper.set_link("node-2", LinkFault(delay_ms=40, jitter_ms=30))
    frames = [numbered(number) for number in range(50)]
    arrived = await carry(shaper, frames, apart_s=0.002)
    assert [frame for _, frame in arrived] == frames
    waits = [at - 0.002 * place for place, (at, _) in enumerate(arrived)]
    assert min(waits) >= 0.0399
    assert max(waits) <= 0.0701
    assert len({round(wait, 4) for wait in waits}) > 10


@in_virtual_time
async def test_loss_takes_whole_frames_about_as_many_as_it_says_and_never_a_greeting() -> None:
    shaper = LinkFaultShaper("node-1", seed=1)
    shaper.set_link("node-2", LinkFault(loss=0.3))
    frames = [numbered(number) for number in range(1_000)]
    arrived = [frame for _, frame in await carry(shaper, frames)]
    assert 640 < len(arrived) < 760
    assert arrived == [frame for frame in frames if frame in set(arrived)]
    assert shaper.lost_count == 1_000 - len(arrived)
    assert len(await carry(shaper, [HELLO] * 50)) == 50


@in_virtual_time
async def test_the_same_seed_loses_the_same_frames_and_each_link_its_own() -> None:
    async def lost(own: str, seed: int) -> list[bytes]:
        shaper = LinkFaultShaper(own, seed)
        shaper.set_link("node-2", LinkFault(loss=0.5))
        return [frame for _, frame in await carry(shaper, [numbered(number) for number in range(64)])]

    assert await lost("node-1", 7) == await lost("node-1", 7)
    assert await lost("node-1", 7) != await lost("node-1", 8)
    assert await lost("node-1", 7) != await lost("node-3", 7)


@in_virtual_time
async def test_seeding_again_begins_the_chance_of_a_link_anew() -> None:
    shaper = LinkFaultShaper("node-1", seed=7)
    shaper.set_link("node-2", LinkFault(loss=0.5))
    frames = [numbered(number) for number in range(64)]
    first = [frame for _, frame in await carry(shaper, frames)]
    shaper.reseed(7)
    assert [frame for _, frame in await carry(shaper, frames)] == first


@in_virtual_time
async def test_a_cut_lets_nothing_through_not_even_what_is_on_its_way_and_refuses_connections() -> None:
    shaper = LinkFaultShaper("node-1")
    shaper.set_link("node-2", LinkFault(delay_ms=100))
    arrived: list[bytes] = []
    shaper.deliver("node-2", VOTE, arrived.append)
    await asyncio.sleep(0.05)
    shaper.set_link("node-2", LinkFault(cut=True))
    assert not shaper.admits("node-2")
    assert shaper.admits("node-3")
    shaper.deliver("node-2", VOTE, arrived.append)
    await asyncio.sleep(1)
    assert arrived == []
    shaper.set_link("node-2", LinkFault())
    assert shaper.admits("node-2")
    shaper.deliver("node-2", VOTE, arrived.append)
    assert arrived == [VOTE]


@in_virtual_time
async def test_what_waits_keeps_its_turn_when_the_link_is_sound_again() -> None:
    shaper = LinkFaultShaper("node-1")
    shaper.set_link("node-2", LinkFault(delay_ms=100))
    arrived: list[bytes] = []
    shaper.deliver("node-2", numbered(1), arrived.append)
    shaper.clear()
    shaper.deliver("node-2", numbered(2), arrived.append)
    await asyncio.sleep(1)
    assert arrived == [numbered(1), numbered(2)]


@in_virtual_time
async def test_what_waits_is_counted_and_bounded() -> None:
    shaper = LinkFaultShaper("node-1")
    shaper.set_link("node-2", LinkFault(delay_ms=1_000))
    large = encode_frame(FrameKind.RESPONSE, bytes(8 * 1024 * 1024 - 16))
    for _ in range(6):
        shaper.deliver("node-2", large, lambda _: None)
    assert shaper.waiting_bytes("node-2") == 4 * len(large)
    assert shaper.waiting_bytes("node-2") <= QUEUE_MAX_BYTES
    assert shaper.lost_count == 2
    await asyncio.sleep(2)
    assert shaper.waiting_bytes("node-2") == 0


@in_virtual_time
async def test_one_direction_is_not_the_other() -> None:
    shaper = LinkFaultShaper("node-1")
    shaper.set_link("node-2", LinkFault(cut=True))
    arrived: list[bytes] = []
    shaper.deliver("node-3", VOTE, arrived.append)
    assert arrived == [VOTE]


@pytest.mark.parametrize(
    "figures",
    [
        {"delay_ms": -1.0},
        {"delay_ms": float("nan")},
        {"jitter_ms": 1e9},
        {"loss": 1.0},
        {"loss": -0.1},
        {"loss": float("inf")},
        {"bandwidth_bytes_per_s": -1},
    ],
)
def test_figures_that_make_no_sense_are_refused(figures: dict[str, float]) -> None:
    with pytest.raises(BlockRobotError, match=r"^FAULT_INVALID:"):
        LinkFaultShaper("node-1").set_link("node-2", msgspec.structs.replace(LinkFault(), **figures))


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (LinkFault(), "sound"),
        (LinkFault(cut=True, delay_ms=3), "cut"),
        (
            LinkFault(delay_ms=20, jitter_ms=60, loss=0.1, bandwidth_bytes_per_s=625_000),
            "20-80 ms, 10.0% lost, 625 kB/s",
        ),
    ],
)
def test_a_link_says_what_is_wrong_with_it(fault: LinkFault, words: str) -> None:
    assert fault.describe() == words
