"""The judge of pages itself: it finds what is wrong, and has nothing to say of a good page. And the network is there."""

from __future__ import annotations

import re

import pytest
from playwright.async_api import Page

from clients.wallet.records.viewing import RecordViewer
from tests.ui.accessible import find_accessibility_faults
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.watched_page import NARROW, Pages, Watch

GOOD = """<!doctype html><html lang=en><meta name=viewport content="width=device-width, initial-scale=1"><title>Good</title>
<body style="background:#fff;color:#222"><main><h1>Records</h1><p>Some <a href="#a">link in a sentence</a> of words.</p>
<h2 id=a>Days</h2><label>Day <input name=day style="height:30px"></label>
<button style="min-height:30px">Play</button><svg role=img aria-label="a line" width=10 height=10></svg>
<table><tr><th>Day</th></tr><tr><td>1</td></tr></table></main></body></html>"""
ONE = "<html lang=en><title>x</title><main><h1>x</h1>"
WIDE_TABLE = "<table><tr><th><div style='width:3000px'>Day</div></th></tr><tr><td>1</td></tr></table>"
BAD = {
    "html-has-lang": "<html><title>x</title><main><h1>x</h1></main>",
    "button-name": ONE + "<button style='width:40px;height:40px'></button></main>",
    "image-alt": ONE + "<img src='data:,'></main>",
    "heading-order": ONE + "<h3>y</h3></main>",
    "landmark-one-main": "<html lang=en><title>x</title><header><h1>x</h1></header>",
    "color-contrast": ONE + "<p style='color:#999'>pale</p></main>",
    "tabindex": ONE + "<a href='#' tabindex=3>a</a></main>",
    "label": ONE + "<input placeholder=Day style='height:40px'></main>",
    "target": ONE + "<button style='padding:0;font-size:8px'>a</button></main>",
    "id": "<html lang=en><title>x</title><main><h1 id=a>x</h1><p id=a>y</p></main>",
    "reflow": ONE + "<div style='width:3000px'>wide</div></main>",
    "scroll": ONE + f"<div tabindex=0 style='overflow-x:auto'>{WIDE_TABLE}</div></main>",
    "focus": ONE + "<button style='outline:none;min-height:30px;min-width:30px'>a</button></main>",
    "keyboard": ONE + "<span role=button style='display:block;height:30px'>do</span></main>",
    "reference": "<html lang=en><title>x</title><main aria-labelledby=gone><h1>x</h1></main>",
    "name": ONE + "<canvas></canvas></main>",
    "picture": ONE + "<svg width=9 height=9></svg></main>",
    "contrast": ONE + "<svg aria-label=a role=img><text y=20 fill='#999'>pale</text></svg></main>",
    "table": ONE + "<table><tr><td>1</td></tr></table></main>",
}


@pytest.mark.smoke
async def test_a_good_page_has_no_faults(page: Page) -> None:
    await page.set_content(GOOD)
    assert await find_accessibility_faults(page) == []


@pytest.mark.smoke
async def test_every_kind_of_fault_is_found_and_named(page: Page) -> None:
    found = {}
    for kind, text in BAD.items():
        await page.set_content("<!doctype html>" + text)
        found[kind] = [
            re.sub(r"^axe: (serious|critical|moderate|minor) ", "", fault).partition(":")[0]
            for fault in await find_accessibility_faults(page)
        ]
    assert found == {kind: [kind] for kind in BAD}


async def test_a_table_that_is_cut_off_is_found_and_one_that_scrolls_in_its_own_region_is_not(page: Page) -> None:
    async def found(attributes: str) -> list[str]:
        await page.set_content(f"<!doctype html>{ONE}<div {attributes}>{WIDE_TABLE}</div></main>")
        return [fault.partition(":")[0] for fault in await find_accessibility_faults(page)]

    assert await found('tabindex=0 role=region aria-label="Days" style="overflow-x:auto"') == []
    assert await found('tabindex=0 role=region aria-label="Days" style="overflow-x:hidden"') == ["scroll"]
    assert await found('tabindex=0 role=region style="overflow-x:auto"') == ["scroll"]


async def test_pale_words_on_a_dark_ground_of_an_outer_element_are_found(pages: Pages) -> None:
    page = await pages.open(NARROW, color_scheme="dark")
    await page.set_content(
        "<!doctype html><html lang=en><title>x</title><main style='background:#111'><h1 style='color:#eee'>x</h1>"
        "<p style='color:#444'>pale</p><p style='color:rgba(255,255,255,.9)'>well</p></main>"
    )
    (fault,) = await find_accessibility_faults(page)
    assert fault.startswith("axe: serious color-contrast")
    assert fault.count("(<p") == 1


async def test_what_a_page_complains_of_and_whom_it_calls_is_noticed(page: Page, watch: Watch) -> None:
    await page.set_content("<script>console.error('broken'); fetch('http://192.0.2.1/x').catch(() => {})</script>")
    await page.wait_for_timeout(50)
    faults = watch.unexpected()
    assert any("broken" in fault for fault in faults)
    assert "request to http://192.0.2.1/x" in faults
    watch.expect("broken|192.0.2.1")
    assert watch.unexpected() == []


async def test_a_recorded_person_can_look_at_her_record(recorded_network: RecordedNetwork) -> None:
    (entry,) = recorded_network.records[:1]
    async with recorded_network.wallet() as ann:
        viewing = RecordViewer(ann)
        access_id = await viewing.request_access([entry], "demo")
        view = await viewing.view(entry, access_id)
    assert entry.metadata.frame_count == len(view.frames) > 0
