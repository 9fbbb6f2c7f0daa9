"""The wallet's page when nobody is at it, when its session is over, and when she was told less than there is.

Behind it are real contracts and proofs in this process; no network is started.
"""

from __future__ import annotations

import asyncio
import dataclasses
import re
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio
from msgspec.structs import replace
from playwright.async_api import Dialog, Page, Route, expect

from clients.wallet.consent.consent_choices import ConsentClient, ConsentDecision
from clients.wallet.page.routes import clip_routes
from consensus.records.metadata import NOTICE_SENSOR
from consensus.rights.notices import encode_notice
from network.notices.notice_publishing import demo_notice
from tests.ui.shown_page import COMMAND, SOON_MS, Shown, show_ward
from tests.ui.watched_page import SERVER_ENDED, Watch
from tests.world.sharing import SharedWard


@pytest_asyncio.fixture(loop_scope="session")
async def shown(tmp_path: Path, page: Page) -> AsyncIterator[Shown]:
    ward = SharedWard(tmp_path)
    ward.record_visit()
    async with show_ward(ward, page) as shown:
        await expect(page.locator(".lead")).to_contain_text("2 recordings", timeout=SOON_MS)
        yield shown


async def test_once_the_session_is_over_the_screen_is_cleared_and_says_how_to_come_back(
    shown: Shown, watch: Watch
) -> None:
    watch.expect("status of 401")
    page = shown.page
    shown.served.end_sessions()
    await page.get_by_role("link", name="What happened").click()
    await expect(page.locator("h1")).to_be_focused(timeout=SOON_MS)
    await expect(page.locator("#main code")).to_have_text(COMMAND)
    await expect(page.locator("nav")).to_have_count(0)
    assert "recording" not in (await page.locator("body").inner_text()).lower()
    await page.evaluate("() => { location.hash = '#/inbox'; }")
    await expect(page.locator("h1")).to_have_text(await page.locator("h1").inner_text())
    await expect(page.locator("#main code")).to_have_text(COMMAND)


async def test_of_a_locked_page_no_reader_is_told_what_came_in_before(shown: Shown, watch: Watch) -> None:
    watch.expect(f"status of 401|{SERVER_ENDED}")
    page = shown.page
    await shown.record()
    aloud = page.locator("[role=status][aria-live=polite]")
    await expect(aloud).to_contain_text("came in", timeout=SOON_MS)
    await page.get_by_role("button", name="Lock").click()
    await expect(page.locator("h1")).to_have_text("The wallet is locked")
    await expect(aloud).to_have_text("")
    await expect(page.locator("#main code")).to_have_text(COMMAND)


async def test_the_line_of_what_came_in_goes_when_that_is_shown(shown: Shown) -> None:
    page = shown.page
    await shown.record()
    news = page.locator("#news")
    await expect(news).to_contain_text("came in", timeout=SOON_MS)
    await page.get_by_role("link", name="What happened").click()
    await expect(page.locator(".story").first).to_be_visible(timeout=SOON_MS)
    await expect(news).to_contain_text("came in")
    await page.evaluate("() => { location.hash = '#/'; }")
    await page.locator(".latest a").first.click()
    await expect(page.locator("input[data-visit]").first).to_be_visible(timeout=SOON_MS)
    await expect(news).to_be_empty()


async def test_what_comes_in_while_a_view_is_on_its_way_is_on_it_too(shown: Shown) -> None:
    page = shown.page
    await shown.go("inbox")
    was_read, goes_on = asyncio.Event(), asyncio.Event()

    async def answer_late(route: Route) -> None:
        answer = await route.fetch()
        was_read.set()
        await goes_on.wait()
        await route.fulfill(response=answer)

    await page.route("**/days?*", answer_late, times=1)
    await page.evaluate("() => { location.hash = '#/'; }")
    await was_read.wait()
    await shown.record()
    await expect(page.locator("#news")).to_contain_text("came in", timeout=SOON_MS)
    goes_on.set()
    await expect(page.locator("[data-day].has .count")).to_have_text("4", timeout=SOON_MS)


async def test_a_long_name_stays_within_its_card_and_the_form_takes_no_longer_one(shown: Shown) -> None:
    page, ward = shown.page, shown.ward
    doctor = ward.come_in("doctor", "staff")
    name = "W" * 100
    await ward.share(doctor, label=name)
    async with shown.session.lock:
        await shown.session.read()
    await page.evaluate("() => { location.hash = '#/sharing'; }")
    await expect(page.get_by_role("heading", name=name)).to_be_visible(timeout=SOON_MS)
    for width in (1280, 400):
        await page.set_viewport_size({"width": width, "height": 800})
        assert await page.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), width


async def test_a_wrong_handle_is_answered_without_naming_a_command(shown: Shown, watch: Watch) -> None:
    watch.expect("status of 40[03]")
    page = shown.page
    await page.locator(".latest a").first.click()
    await page.locator("input[data-visit]").first.check(timeout=SOON_MS)
    await page.get_by_role("button", name="Share…").click()
    for label, longest in (("With whom?", "200"), ("What you call them", "100")):
        await expect(page.get_by_label(label)).to_have_attribute("maxlength", longest, timeout=SOON_MS)
    for wanted in ("Dr Nobody", "ab" * 32):
        await page.get_by_label("With whom?").fill(wanted)
        await page.get_by_role("button", name="See what that means").click()
        told = page.get_by_role("alert")
        await expect(told).to_contain_text("A handle begins with brh1, or has 64 letters and digits", timeout=SOON_MS)
        assert "blockrobot" not in await told.inner_text()


async def test_before_the_file_is_made_the_page_says_what_it_gives_away(shown: Shown) -> None:
    page = shown.page
    await shown.record()
    await page.evaluate("() => { location.hash = '#/export'; }")
    await page.get_by_role("button", name="See what goes along").click(timeout=SOON_MS)
    told = page.locator("section.card", has_text="Whoever has the file learns")
    for words in ("2 meetings were of one person", "which member of the network", "later erasure does not reach it"):
        await expect(told).to_contain_text(words, timeout=SOON_MS)
    await expect(told).to_contain_text("one by one")
    await page.get_by_label("With your membership").uncheck()
    await page.get_by_label("With the pictures").uncheck()
    await page.get_by_role("button", name="See what goes along").click()
    await expect(told).not_to_contain_text("which member of the network", timeout=SOON_MS)
    await expect(told).not_to_contain_text("one by one")


async def test_a_page_that_was_reloaded_says_how_to_come_back(shown: Shown, watch: Watch) -> None:
    watch.expect("status of 401")
    page = shown.page
    await page.get_by_role("link", name="What happened").click()
    await expect(page.locator(".story").first).to_be_visible(timeout=SOON_MS)
    await page.reload()
    await expect(page.get_by_role("alert")).to_contain_text("press Enter in the terminal", timeout=SOON_MS)
    await expect(page.locator("#main code")).to_have_text(COMMAND)


async def test_a_used_link_in_a_fresh_tab_names_the_command_of_this_very_wallet_and_a_bare_address_none(
    shown: Shown, watch: Watch
) -> None:
    watch.expect("status of 401")
    link = re.search(r'url=([^"]+)"', (await shown.served.new_link()).read_text())
    assert link
    fresh = [await shown.page.context.new_page() for _ in range(3)]
    await fresh[0].goto(link[1])
    await expect(fresh[0].locator(".lead")).to_contain_text("2 recordings", timeout=SOON_MS)
    await fresh[1].goto(link[1])
    await expect(fresh[1].get_by_role("alert")).to_contain_text("press Enter in the terminal", timeout=SOON_MS)
    await expect(fresh[1].locator("#main code")).to_have_text(COMMAND)
    await fresh[2].goto(shown.served.url)
    await expect(fresh[2].get_by_role("alert")).to_contain_text("press Enter in the terminal", timeout=SOON_MS)
    await expect(fresh[2].locator("#main code")).to_have_count(0)
    for page in fresh:
        await page.close()


async def test_whoever_reloads_while_something_is_under_way_is_asked_first(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, may_go_on, was_asked, asked = shown.page, asyncio.Event(), asyncio.Event(), list[str]()
    refuse = ConsentClient.refuse

    async def slowly(self: ConsentClient, *what: list[str]) -> ConsentDecision:
        await may_go_on.wait()
        return await refuse(self, *what)

    async def stay(dialog: Dialog) -> None:
        asked.append(dialog.type)
        await dialog.dismiss()
        was_asked.set()

    monkeypatch.setattr(ConsentClient, "refuse", slowly)
    page.on("dialog", stay)
    await page.evaluate("() => { location.hash = '#/consent'; }")
    await page.locator("[data-key=no-research-rgb]").click(timeout=SOON_MS)
    try:
        working = page.get_by_role("progressbar", name="Writing your word into the ledger")
        await expect(working).to_be_visible(timeout=SOON_MS)
        await page.evaluate("() => { setTimeout(() => location.reload(), 0); }")
        async with asyncio.timeout(SOON_MS / 1000):
            await was_asked.wait()
    finally:
        may_go_on.set()
    await expect(page.locator("#main")).to_contain_text("You said no.", timeout=SOON_MS)
    await page.goto("about:blank")
    assert asked == ["beforeunload"], "once nothing is under way nobody is asked"


@pytest.mark.parametrize(
    "place", ["day/2026-99-99", "day/<img src=x onerror=alert(1)>", "day/%", "record/x", "visit/-", "day", "toString"]
)
async def test_an_address_that_names_nothing_is_answered_in_plain_words(shown: Shown, place: str) -> None:
    page = shown.page
    await page.evaluate("(place) => { location.hash = `#/${place}`; }", place)
    await expect(page.locator("h1")).to_have_text("There is no such page", timeout=SOON_MS)
    await page.get_by_role("link", name="To your recordings").click()
    await expect(page.locator(".lead")).to_contain_text("2 recordings", timeout=SOON_MS)


async def test_recordings_that_come_in_keep_no_page_open_at_which_nobody_is(shown: Shown) -> None:
    page = shown.page
    await page.clock.install()
    shown.ward.chain.time_ms += 31 * 60_000
    await page.clock.fast_forward(31 * 60_000)
    await shown.record()
    await expect(page.locator(".lead")).to_contain_text("4 recordings", timeout=SOON_MS)
    assert shown.session.is_idle(30)
    await page.keyboard.press("Tab")
    await page.get_by_role("link", name="What happened").click()
    await expect(page.locator(".story").first).to_be_visible(timeout=SOON_MS)
    assert not shown.session.is_idle(30)


async def test_what_the_notice_does_not_name_has_a_no_and_no_yes(shown: Shown) -> None:
    page, chain = shown.page, shown.ward.chain
    kept = [purpose for purpose in demo_notice().purposes if purpose.code != "care"]
    chain.must(chain.admin, "consent", "publish_notice", encode_notice(replace(demo_notice(), purposes=kept)))
    await page.evaluate("() => { location.hash = '#/consent'; }")
    await page.get_by_role("button", name="I have read it").click(timeout=SOON_MS)
    unnamed = page.locator(".choices", has_text="does not name this")
    await expect(unnamed).to_have_count(1)
    await expect(unnamed.locator("[data-key^=yes]")).to_have_count(0)
    await expect(unnamed.locator("[data-key^=no]").first).to_be_enabled()
    await expect(page.locator(".choices:not(:has-text('does not name this')) [data-key^=yes]").first).to_be_enabled()


async def test_no_switch_stands_where_the_notice_names_no_sensor_or_asks_for_no_consent(shown: Shown) -> None:
    page, chain = shown.page, shown.ward.chain
    chain.must(chain.admin, "consent", "publish_notice", encode_notice(demo_notice()))
    await page.evaluate("() => { location.hash = '#/consent'; }")
    await page.get_by_role("button", name="I have read it").click(timeout=SOON_MS)
    safety, audit = (page.locator(f".choices[aria-labelledby=purpose-{code}]") for code in ("safety", "audit"))
    await expect(safety.locator("[data-key^=yes]")).to_have_count(1)
    await expect(safety.locator("[data-key=yes-safety-depth]")).to_be_enabled()
    await expect(audit).to_contain_text("it rests on Art. 6(1)(c) GDPR (a legal duty)")
    await expect(audit.locator("button")).to_have_count(0)


async def test_every_view_stands_without_a_complaint_of_the_browser(shown: Shown) -> None:
    page = shown.page
    day = shown.session.snapshot.visits[0].report.records[0]
    for place in ("story", "sharing", "erasing", "export", "inbox", f"record/{day.record_id.hex()}", "day/2026-11-22"):
        await shown.go(place)
        assert await page.locator(".notice.bad").count() == 0, place


async def test_a_note_of_what_was_not_kept_is_no_recording_and_things_are_called_what_they_are(shown: Shown) -> None:
    page = shown.page
    await expect(page.locator(".lead")).to_contain_text("They hold 4 depth pictures.")
    assert "estimate" not in await page.locator("#main").inner_text()
    snapshot = shown.session.snapshot
    (part,) = snapshot.visits
    notes = tuple(
        dataclasses.replace(entry, metadata=replace(entry.metadata, sensor=NOTICE_SENSOR))
        for entry in part.report.records
    )
    only_notes = dataclasses.replace(part, report=dataclasses.replace(part.report, records=notes))
    entries = {entry.record_id: entry for entry in notes}
    shown.session.snapshot = dataclasses.replace(snapshot, visits=(only_notes,), entries=entries)
    shown.session._tell_news()
    cell = page.locator("table.calendar .day.has")
    await expect(cell).to_have_attribute("aria-label", re.compile("2 notes of pictures not kept"), timeout=SOON_MS)
    await expect(page.locator(".lead")).to_contain_text("Robots made 0 recordings of you.")
    await page.locator(".latest a").click()
    await expect(page.locator("section.card h2", has_text="2 notes of pictures not kept")).to_be_visible()
    await page.locator("input[data-visit]").check()
    await page.get_by_role("button", name="Erase…").click()
    await expect(page.get_by_role("heading", name="What remains")).to_be_visible(timeout=SOON_MS)
    assert "with whom you shared" not in await page.locator("#main").inner_text(), "nothing is shared"
    await expect(page.locator("#main")).to_contain_text("The notes of what was not kept. No picture hangs on them.")


async def test_of_a_meeting_too_large_for_one_clip_every_part_can_be_watched(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_routes, "CLIP_MAX_BYTES", 1)
    page = shown.page
    await page.locator(".latest a").click()
    await page.locator(".visit-row a.button").click()
    await expect(page.locator("#main")).to_contain_text("Part 1 of 2", timeout=SOON_MS)
    await page.get_by_role("button", name="Next part").click()
    await expect(page.locator("#main")).to_contain_text("Part 2 of 2", timeout=SOON_MS)
    await expect(page.locator(".seal")).to_have_attribute("data-seal", "good")
