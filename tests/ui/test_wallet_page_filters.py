"""The calendar by robot and by sensor: what fits is shown, what does not is not called gone, and all comes back."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest_asyncio
from playwright.async_api import Page, expect

from consensus.records.renditions import ENCODING_LABEL, RENDITION_VERSION, Rendition
from tests.ui.accessible import find_accessibility_faults
from tests.ui.shown_page import SOON_MS, Shown, show_ward
from tests.world.sharing import SharedWard

DAY_MS = 24 * 60 * 60 * 1_000
FIRST_DAY, SECOND_DAY = "2023-11-14", "2023-11-15"
CALM = b'{"label":"calm"}'


def record_estimate(ward: SharedWard) -> None:
    """Have the robot of the hour estimate how she feels."""
    visit, now_ms = ward.open_visit(), ward.chain.time_ms
    told = Rendition(RENDITION_VERSION, now_ms, 0, 1, 1, 0, 0, 0, 0, bytes(32), ENCODING_LABEL, CALM)
    ward.record(visit, renditions=[told], sensor="emotion")
    ward.close_visit(visit)


@pytest_asyncio.fixture(loop_scope="session")
async def shown(tmp_path: Path, page: Page) -> AsyncIterator[Shown]:
    """A robot films her with its depth camera; another one does so the day after, and estimates how she feels."""
    ward = SharedWard(tmp_path)
    ward.record_visit()
    ward.chain.time_ms += DAY_MS
    ward.chain.robot = ward.chain.enrol("another robot", "robot")
    ward.record_visit(count=1)
    record_estimate(ward)
    async with show_ward(ward, page) as shown:
        yield shown


async def test_by_robot_and_sensor_she_finds_what_she_looks_for_and_nothing_is_called_gone(shown: Shown) -> None:
    page = shown.page
    first, second = (part.report.visit.robot.hex() for part in shown.session.snapshot.visits[:2])
    assert first != second
    robot, sensor = (page.get_by_role("combobox", name=name, exact=True) for name in ("Robot", "Sensor"))
    days, latest = page.locator("table.calendar .day.has"), page.locator(".latest li")

    async def expect_days(found: dict[str, int]) -> None:
        await expect(days).to_have_count(len(found), timeout=SOON_MS)
        await expect(latest).to_have_count(len(found))
        for day, count in found.items():
            await expect(page.locator(f"[data-day='{day}'] .count")).to_have_text(str(count))

    await expect_days({FIRST_DAY: 2, SECOND_DAY: 2})
    await robot.focus()
    await robot.select_option(first)
    await expect_days({FIRST_DAY: 2})
    await expect(robot).to_be_focused()
    await expect(page.locator(f"[data-day='{SECOND_DAY}']")).to_have_attribute("aria-disabled", "true")
    await robot.select_option(second)
    await sensor.select_option(label="Estimate of how you feel")
    await expect_days({SECOND_DAY: 1})
    assert await find_accessibility_faults(page) == []

    await robot.select_option(first)
    await expect_days({})
    main = page.locator("#main")
    await expect(main).to_contain_text("No recording is by this robot and this sensor.")
    await expect(main).to_contain_text("Robots made 4 recordings of you.")
    await expect(main).not_to_contain_text("Nothing was recorded of you.")
    assert await find_accessibility_faults(page, by_keyboard=False) == []

    await shown.go("story")
    await shown.go("")
    await expect(robot).to_have_value(first)
    await expect(sensor).to_have_value("emotion")
    await robot.select_option(label="All robots")
    await expect_days({SECOND_DAY: 1})
    await sensor.select_option(label="All sensors")
    await expect_days({FIRST_DAY: 2, SECOND_DAY: 2})
    await expect(main).not_to_contain_text("No recording is by")


async def test_what_comes_in_while_something_else_is_looked_for_does_not_show_and_is_there_afterwards(
    shown: Shown,
) -> None:
    page = shown.page
    sensor = page.get_by_role("combobox", name="Sensor", exact=True)
    await sensor.select_option("depth")
    count = page.locator(f"[data-day='{SECOND_DAY}'] .count")
    await expect(count).to_have_text("1", timeout=SOON_MS)
    record_estimate(shown.ward)
    await shown.read()
    await expect(page.locator("#news")).to_contain_text("came in", timeout=SOON_MS)
    await expect(count).to_have_text("1")
    await sensor.select_option("emotion")
    await expect(count).to_have_text("2", timeout=SOON_MS)
