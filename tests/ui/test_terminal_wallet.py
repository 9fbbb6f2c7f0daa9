"""A recorded person's wallet at a terminal: what she sees, narrow or wide, with colour or without, and when nodes fail."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path
from typing import Any

from PIL import Image

from tests.ui.recorded_network import RecordedNetwork
from tests.ui.typed import Typed, at_terminal, plain

ESCAPE = re.compile(r"\x1b\[[0-9;]*m")


def begin(network: RecordedNetwork, *arguments: str, **terminal: Any) -> Typed:
    """Begin a command of her wallet, and give the passphrase."""
    group = network.wallet_arguments[1:]
    typed = at_terminal(network.folder, *group, *arguments, **terminal)
    typed.answer("(?i)(pass|frase)[^:]*: ", network.passphrase)
    return typed


async def said(network: RecordedNetwork, *arguments: str, code: int = 0, **terminal: Any) -> str:
    """Return what a command wrote."""

    def run() -> str:
        typed = begin(network, *arguments, **terminal)
        assert typed.ended() == code, typed.rest()
        return typed.rest()

    return await asyncio.to_thread(run)


async def test_a_narrow_terminal_in_no_colour_and_portuguese(recorded_network: RecordedNetwork) -> None:
    ann = recorded_network
    name = ann.records[0].record_id.hex()
    wide = await said(ann, "records")
    assert name in plain(wide)
    narrow = await said(ann, "records", columns=30, environment={"NO_COLOR": "1", "BLOCKROBOT_LANGUAGE": "pt"})
    assert not ESCAPE.search(narrow)
    assert name[:12] in plain(narrow)
    assert name not in plain(narrow)
    assert "Encontro 1" in plain(narrow)
    none = await said(ann, "records", "--day", "1999-12-31")
    assert "fits" in plain(none) or "does not fit" in plain(none)


async def test_what_is_viewed_is_shown_in_the_terminal_and_written_as_sheet_and_animation(
    recorded_network: RecordedNetwork, tmp_path: Path
) -> None:
    ann = recorded_network
    name = ann.records[0].record_id.hex()
    coloured = await said(ann, "view", name[:12], "--out", str(tmp_path / "a"), environment={"COLORTERM": "truecolor"})
    assert "are as the robot took them" in plain(coloured)
    assert "▀" in coloured
    assert "38;2;" in coloured
    with Image.open(tmp_path / "a" / name / "contact-sheet.png") as sheet:
        assert sheet.width > 240
    with Image.open(tmp_path / "a" / name / "animation.gif") as moving:
        assert moving.format == "GIF"
    drawn = await said(ann, "view", name[:12], "--out", str(tmp_path / "b"), term="xterm-kitty")
    assert "\x1b_Ga=T,f=100" in drawn
    letters = await said(ann, "view", name[:12], "--out", str(tmp_path / "c"), environment={"LC_ALL": "C"}, columns=60)
    assert "▀" not in letters
    assert re.search(r"[=+*#%@]{10}", letters)
    quiet = await said(ann, "view", name[:12], "--out", str(tmp_path / "d"), "--no-show", "--no-sheet")
    assert "▀" not in quiet
    assert not (tmp_path / "d" / name / "contact-sheet.png").exists()


async def test_a_name_that_nobody_has_ends_in_not_found_and_a_program_gets_one_object(
    recorded_network: RecordedNetwork,
) -> None:
    unknown = await said(recorded_network, "view", "00" * 16, code=3)
    assert "Next step: " in plain(unknown)
    told = await said(recorded_network, "records", "--json")
    assert json.loads(told)["visits"][0]["records"]


async def test_two_commands_on_one_wallet_both_end_well(recorded_network: RecordedNetwork) -> None:
    both = await asyncio.gather(*(said(recorded_network, "records") for _ in range(2)))
    assert all("Visit 1" in plain(one) for one in both)


async def test_erasing_says_what_goes_asks_and_shows_receipts(recorded_network: RecordedNetwork) -> None:
    ann = recorded_network
    name = ann.records[-1].record_id.hex()

    def refuse() -> int:
        typed = begin(ann, "erase", name[:12])
        typed.answer("(?s)Gone will be.*What remains.*Erase. " + r"\[y/N\]: ", "n")
        return typed.ended()

    assert await asyncio.to_thread(refuse) == 1
    assert name in plain(await said(ann, "records"))

    def agree() -> str:
        typed = begin(ann, "erase", name[:12], "--wait")
        typed.answer(r"\[y/N\]: ", "y")
        typed.expect("2 of 2 receipts have come in")
        assert typed.ended() == 0, typed.rest()
        return typed.rest()

    assert "confirmed by 2 of 2 custodians" in plain(await asyncio.to_thread(agree))
    assert name not in plain(await said(ann, "records"))


async def test_with_a_node_killed_the_others_answer(recorded_network: RecordedNetwork) -> None:
    ann = recorded_network
    await asyncio.to_thread(ann.network.cluster.kill, ann.network.names[0])
    assert "Visit 1" in plain(await said(ann, "records"))
