"""The explorer as a member, a lecturer and a passer-by see it, on a real network."""

from __future__ import annotations

import asyncio
import json
import re
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page, Request, Route, expect

from clients.wallet.records.erasure import ErasureClient
from consensus.primitives.encoding import encode_value
from node.config import CONFIG_FILE
from tests.ui.accessible import find_accessibility_faults
from tests.ui.explorer_page import enter, go
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.screenshots import shoot_all_ways
from tests.ui.watched_page import NARROW, SERVER_ENDED, WIDE, ZOOMED, Pages, Watch

PUBLIC_NODE = "node-2"
SHOWN_COUNT = 8  # transactions, so that the page has something to draw
PLACES = ("live", "producers", "block/1", "contracts", "contract/identity", "members", "custody", "governance")
VALUES = [
    {"a": [1, -1, 127, 128, 65_536, 1 << 40], "b": b"\x00\xff", "c": None, "d": True, "e": "žluťoučký"},
    {7: "seven", b"\x01": {"deep": [[]]}},
    -33,
    -40_000,
    (1 << 64) - 1,
    1 << 200,
    -(1 << 90),
    "x" * 300,
    list(range(40)),
    {f"k{number:02}": number for number in range(20)},
]


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def public_url(recorded_network: RecordedNetwork) -> AsyncIterator[str]:
    """A node whose explorer is public: its configuration says so, and it was started again."""
    cluster = recorded_network.network.cluster
    await asyncio.to_thread(cluster.stop, PUBLIC_NODE)
    path = cluster.config(PUBLIC_NODE).data_dir / CONFIG_FILE
    path.write_text(path.read_text() + "\n[explorer]\npublic = true\n")
    cluster.start(PUBLIC_NODE)
    await cluster.wait_ready()
    yield recorded_network.api_url(PUBLIC_NODE) + "/explorer/"


async def refuse_something(network: RecordedNetwork) -> dict[str, Any]:
    """Let a contract refuse a call; return where the transaction is."""
    return await network.network.finalize("node-1", network.network.transaction())


async def test_the_command_opens_the_explorer_once_by_a_file_that_only_its_owner_can_read(
    pages: Pages, watch: Watch, recorded_network: RecordedNetwork
) -> None:
    command = [sys.executable, "-m", "network.cli.main", "explore", "--node", "node-1", "--profile", "ann", "--json"]
    home = {
        "BLOCKROBOT_HOME": str(recorded_network.folder),
        "BLOCKROBOT_PASSPHRASE_FILE": str(recorded_network.passphrase_file),
        "PATH": "/usr/bin:/bin",
    }
    process = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE, env=home)
    try:
        assert process.stdout is not None
        told = json.loads(await process.stdout.readuntil(b"}\n"))
        assert (told["node"], told["as"]) == ("node-1", "ann")
        file = Path(told["redirect_file"])
        modes, text = await asyncio.to_thread(
            lambda: ([oct(one.stat().st_mode) for one in (file, file.parent)], file.read_text())
        )
        assert [mode[-3:] for mode in modes] == ["600", "700"]
        found = re.search(r'href="(http://[0-9.]+:[0-9]+/)#([\w-]{43})"', text)
        assert found is not None
        origin, token = found.groups()
        asked: list[Request] = []
        page = await pages.open()
        page.on("request", lambda request: asked.insert(0, request))
        await page.goto(file.as_uri(), wait_until="commit")
        await expect(page.locator("#state")).to_have_text("your session")
        assert token not in page.url
        assert asked[0].url.startswith(origin)
        assert not [one for one in asked if not one.url.startswith((origin, "file:"))], "only the command is asked"
        sent = [f"{request.url.partition('#')[0]} {request.headers}" for request in asked]
        assert not [one for one in sent if token in one or "cookie" in one or "authorization" in one]
        assert await page.evaluate("[document.cookie, localStorage.length, sessionStorage.length]") == ["", 0, 0]
        assert not await asyncio.to_thread(file.exists)
        watch.expect(f"status of 40[01]|{SERVER_ENDED}")
        again = await pages.open()
        await again.goto(f"{origin}#{token}")
        await expect(again.locator("h1")).to_have_text("Look at the chain")
        await expect(again.locator("main .notice")).to_contain_text("has been used")
    finally:
        process.terminate()
        assert await process.wait() == 0


async def test_the_nodes_own_address_opens_no_session_whatever_is_handed_to_it(
    page: Page, watch: Watch, recorded_network: RecordedNetwork
) -> None:
    """Whoever had the address while the node was down may have left a service worker there."""
    watch.expect("status of 401")
    posted: list[Request] = []
    page.on("request", lambda request: posted.append(request) if request.method == "POST" else None)
    await page.goto(recorded_network.api_url("node-1") + f"/explorer/#in={'02' * 33}.{'00' * 32}.{'00' * 65}")
    await expect(page.locator("h1")).to_have_text("Look at the chain")
    assert posted == []


async def test_without_a_session_the_page_says_how_to_get_in_and_shows_nothing(
    page: Page, watch: Watch, recorded_network: RecordedNetwork
) -> None:
    watch.expect("status of 401")
    await page.goto(recorded_network.api_url("node-1") + "/explorer/#/block/1")
    await expect(page.locator("main")).to_contain_text("blockrobot explore")
    assert not await page.locator("#tools").is_visible()
    assert await find_accessibility_faults(page) == []


async def test_blocks_appear_live_and_can_be_held_still(page: Page, recorded_network: RecordedNetwork) -> None:
    await enter(page, recorded_network.network)
    place = await refuse_something(recorded_network)
    await expect(page.locator(f"#blocks a[href='#/block/{place['height']}']")).to_be_visible()
    await expect(page.locator(".figure").nth(2)).to_contain_text("ms")
    await page.get_by_role("button", name="Hold still").click()
    before = await page.locator("#blocks tbody").inner_text()
    await refuse_something(recorded_network)
    await page.wait_for_timeout(600)
    assert await page.locator("#blocks tbody").inner_text() == before
    await page.get_by_role("button", name="Go on").click()
    await expect(page.locator("#blocks tbody")).not_to_have_text(before, use_inner_text=True)


async def test_nothing_is_left_out_while_the_connection_was_broken(
    page: Page, watch: Watch, recorded_network: RecordedNetwork
) -> None:
    watch.expect("ERR_INTERNET_DISCONNECTED")
    await enter(page, recorded_network.network)
    await page.context.set_offline(True)
    await expect(page.locator("#state")).to_contain_text("not connected", timeout=20_000)
    for _ in range(3):
        place = await refuse_something(recorded_network)
    await page.context.set_offline(False)
    await expect(page.locator(f"#blocks a[href='#/block/{place['height']}']")).to_be_visible(timeout=20_000)
    heights = await page.locator("#blocks tbody tr td:first-child").all_inner_texts()
    numbers = [int(text) for text in heights]
    assert numbers == list(range(numbers[0], numbers[0] - len(numbers), -1))
    kept = "() => import('./feed.js').then(({feed}) => feed.headers.map((header) => header.height))"
    everything = await page.evaluate(kept)
    assert everything == list(range(everything[0], everything[-1] + 1))


async def test_the_page_keeps_500_headers_at_most(page: Page, recorded_network: RecordedNetwork) -> None:
    await enter(page, recorded_network.network)
    count = """async () => {
      const { feed, KEPT_COUNT } = await import('./feed.js');
      const { api } = await import('./api.js');
      const one = feed.headers.at(-1);
      const page = (from, limit) => Array.from({ length: limit }, (_, index) => ({ ...one, height: from + index }));
      api.headers = async (from, limit) => ({ headers: page(from, limit) });
      for (let step = 1; step <= 12; step += 1) {
        feed.status = { ...feed.status, head: one.height + 100 * step };
        await feed.catchUp();
      }
      return [KEPT_COUNT, feed.headers.length];
    }"""
    kept, found = await page.evaluate(count)
    assert kept == 500
    assert found <= 500


async def test_where_clocks_differ_no_time_below_nothing_is_told(page: Page, recorded_network: RecordedNetwork) -> None:
    place = await refuse_something(recorded_network)
    await enter(page, recorded_network.network)
    await expect(page.locator(f"#blocks a[href='#/block/{place['height']}']")).to_be_visible()
    await page.evaluate(
        "() => import('./feed.js').then(({ feed }) => { "
        "for (const header of feed.headers) if (header.finality_lag_ms !== null) header.finality_lag_ms = -1500; "
        "feed.dispatchEvent(new Event('change')); })"
    )
    figure = page.locator(".figure").nth(2)
    await expect(figure).to_have_text("clocks differ")
    await expect(page.locator("main")).to_contain_text("1,500 ms or more behind that of the producer")
    await go(page, f"block/{place['height']}")
    await expect(page.locator("dt", has_text="final after").locator("+ dd")).to_contain_text("clocks differ")
    assert "-1,500" not in await page.locator("main").inner_text()


async def test_what_the_page_remembers_is_bounded_by_bytes(page: Page, recorded_network: RecordedNetwork) -> None:
    await enter(page, recorded_network.network)
    block = {"block": "00" * 500_000}
    await page.route("**/v1/blocks/*", lambda route: route.fulfill(json=block))
    memory = await page.evaluate(
        "async () => { const { api, memory } = await import('./api.js'); "
        "for (let height = 1; height <= 40; height += 1) await api.block(1e6 + height); return memory(); }"
    )
    assert 1 <= memory["count"] < 40
    assert memory["bytes"] <= memory["most"] == 8 << 20
    await page.unroute_all(behavior="wait")


async def test_one_loop_follows_the_chain_however_often_it_is_begun(
    page: Page, recorded_network: RecordedNetwork
) -> None:
    await enter(page, recorded_network.network)
    begun = """async () => {
      const { feed } = await import('./feed.js');
      const { api } = await import('./api.js');
      let asked = 0;
      api.status = () => { asked += 1; return new Promise(() => {}); };
      feed.run();
      feed.run();
      return asked;
    }"""
    assert await page.evaluate(begun) == 0


async def test_a_node_that_stands_still_is_told_though_its_connections_are_open(
    page: Page, recorded_network: RecordedNetwork
) -> None:
    await enter(page, recorded_network.network)
    await page.evaluate(
        "() => { const patient = AbortSignal.timeout.bind(AbortSignal); "
        "AbortSignal.timeout = (ms) => patient(ms / 20); AbortSignal.patient = patient; }"
    )
    goes_on = asyncio.Event()

    async def stand_still(route: Route) -> None:
        await goes_on.wait()
        await route.continue_()  # the page may be waiting for this one yet: failing it would be another story

    await page.route("**/v1/explorer/status*", stand_still)
    await expect(page.locator("#state")).to_contain_text("not connected")
    goes_on.set()
    await page.unroute_all(behavior="wait")
    await page.evaluate("() => { AbortSignal.timeout = AbortSignal.patient; }")
    await expect(page.locator("#state")).to_have_text("your session")


async def test_another_network_at_the_same_address_is_not_taken_for_the_same_chain(
    page: Page, watch: Watch, recorded_network: RecordedNetwork
) -> None:
    watch.expect("status of 401")
    await enter(page, recorded_network.network)
    await page.evaluate(
        "() => import('./api.js').then(({ api }) => { const { status } = api; "
        "api.status = async (...asked) => ({ ...await status(...asked), chain_id: '00'.repeat(32) }); })"
    )
    await expect(page.locator("h1")).to_have_text("Look at the chain", timeout=20_000)


async def test_a_time_beyond_all_calendars_is_shown_as_the_number_that_it_is(
    page: Page, recorded_network: RecordedNetwork
) -> None:
    await enter(page, recorded_network.network)
    shown = "[1e30, 2n ** 63n].map((ms) => moment(ms).textContent)"
    assert await page.evaluate(f"() => import('./pieces.js').then(({{ moment }}) => {shown})") == [
        "1e+30 ms",
        "9223372036854775808 ms",
    ]


async def test_custody_says_from_where_on_it_shows_nothing(page: Page, recorded_network: RecordedNetwork) -> None:
    await enter(page, recorded_network.network)
    await page.evaluate(
        "() => import('./api.js').then(({ api }) => { "
        "api.events = async () => ({ events: [], isAll: false, upTo: 7 }); })"
    )
    await go(page, "custody")
    await expect(page.locator("main .notice")).to_contain_text("you see nothing after block 7")
    await expect(page.get_by_role("link", name="Go on from there")).to_have_attribute("href", "#/custody/7")


async def test_a_block_shows_who_certified_it(page: Page, recorded_network: RecordedNetwork) -> None:
    place = await refuse_something(recorded_network)
    await enter(page, recorded_network.network, f"block/{place['height']}")
    await expect(page.locator("h1")).to_have_text(f"Block {place['height']}")
    await expect(page.locator("main")).to_contain_text(place["block_id"])
    assert await page.locator(".ring .seat.voted").count() == 3
    assert await page.locator(".ring .seat.absent").count() == 1
    await page.get_by_role("link", name="the one before").click()
    await expect(page.locator("h1")).to_have_text(f"Block {place['height'] - 1}")


async def test_a_round_that_a_dead_leader_lost_is_told_and_drawn(page: Page, recorded_network: RecordedNetwork) -> None:
    cluster = recorded_network.network.cluster
    await enter(page, recorded_network.network)
    await asyncio.to_thread(cluster.kill, "node-4")
    try:
        for _ in range(4):
            await refuse_something(recorded_network)
    finally:
        cluster.start("node-4")
        await cluster.wait_ready()
    await expect(page.locator("#blocks tbody tr", has_text="lost").first).to_be_visible()
    # On a busy machine other leaders are late too, alone or after it.
    lost = page.locator("main li", has_text=re.compile(r"which (.*, )?node-4(, .*)? should have led"))
    await lost.last.get_by_role("link").click()
    await expect(page.locator("main")).to_contain_text("A round was given up before it")
    assert await page.locator(".ring .seat.gave-up").count() == 3
    await expect(page.locator("main")).to_contain_text(re.compile(r"node-4(, [^.]*)? should have led"))
    await go(page, "producers")
    missed = page.locator("tbody tr", has_text="node-4").locator("td").nth(4)
    assert int(await missed.inner_text()) > 0


async def test_a_refused_transaction_shows_its_code_its_words_and_the_line(
    page: Page, recorded_network: RecordedNetwork
) -> None:
    place = await refuse_something(recorded_network)
    await enter(page, recorded_network.network, f"tx/{place['txid']}")
    shown = page.locator("main")
    for text in ("refused", "HANDLE_UNKNOWN", "Nobody is registered under this handle.", "handle"):
        await expect(shown).to_contain_text(text)
    await expect(shown).to_contain_text("its own words say which")
    await page.get_by_role("link", name=re.compile("line 1")).click()
    marked = page.locator(".source li.here")
    await expect(marked).to_have_count(1)
    assert await marked.evaluate("line => [...line.parentNode.children].indexOf(line) + 1") == place["receipt"]["line"]


async def test_a_contracts_source_is_shown_whole_as_text(page: Page, recorded_network: RecordedNetwork) -> None:
    await enter(page, recorded_network.network, "contract/identity")
    shown = await page.locator(".source li").all_inner_texts()
    source = (Path(__file__).parents[2] / "contracts/privacy/identity.py").read_text().rstrip("\n").split("\n")
    assert [line.rstrip("\n") for line in shown] == source
    await expect(page.locator("main")).to_contain_text("authenticate(handle: bytes)")


@pytest.mark.parametrize(
    ("text", "taken", "found"),
    [
        ("1", "a block's height", "Block 1"),
        ("999999999", "the newest final block is", None),
        ("node-3", "a name", "Producer node-3"),
        ("ident", "a name", "Contract identity"),
        ("00" * 32, "neither a block nor a transaction", None),
        ("02" + "ab" * 32, "Keys are not searched", None),
        ("<img src=x onerror=alert(1)>", "a name", None),
    ],
)
async def test_search_says_what_it_took_the_words_for(
    page: Page, watch: Watch, recorded_network: RecordedNetwork, text: str, taken: str, found: str | None
) -> None:
    watch.expect("status of 404")
    await enter(page, recorded_network.network)
    await page.get_by_role("searchbox").fill(text)
    await page.keyboard.press("Enter")
    await expect(page.locator("main")).to_contain_text(taken)
    await expect(page.locator("#found")).to_contain_text(found or "Nothing was found")


async def test_search_finds_a_block_and_a_transaction_by_their_ids(
    page: Page, watch: Watch, recorded_network: RecordedNetwork
) -> None:
    watch.expect("status of 404")
    place = await refuse_something(recorded_network)
    await enter(page, recorded_network.network)
    for wanted, words in ((place["block_id"], f"Block {place['height']}"), (place["txid"], "Transaction, finalized")):
        await page.get_by_role("searchbox").fill(wanted)
        await page.keyboard.press("Enter")
        await page.get_by_role("link", name=words).click()
        await expect(page.locator("main")).to_contain_text(wanted)


async def test_an_erasure_is_told_with_the_receipt_of_each_custodian_and_with_no_name(
    page: Page, recorded_network: RecordedNetwork
) -> None:
    async with recorded_network.wallet() as ann:
        ((visit, ids),) = await ErasureClient(ann).request_each([recorded_network.records[-1]], [])
        await ErasureClient(ann).wait_complete([(visit, ids)])
    await enter(page, recorded_network.network, "custody")
    await expect(page.get_by_text("receipt; complete")).to_be_visible()
    await page.get_by_role("link", name="1 record").first.click()
    await expect(page.locator("main")).to_contain_text("complete")
    for custodian in ("node-1", "node-2"):
        await expect(page.get_by_role("heading", name=custodian)).to_be_visible()
    await go(page, "members")
    await expect(page.locator("main")).to_contain_text("1 person who may be recorded")
    text = await page.locator("main").inner_text()
    assert "subject" not in text


async def test_values_of_the_chain_are_read_as_they_were_written(page: Page, recorded_network: RecordedNetwork) -> None:
    await enter(page, recorded_network.network)
    script = """async (hexes) => {
      const { decode, Bytes } = await import('./msgpack.js');
      const plain = (v) => v instanceof Bytes ? 'b' + v.hex : typeof v === 'bigint' ? String(v)
        : v instanceof Map ? [...v].map(([k, i]) => [plain(k), plain(i)]) : Array.isArray(v) ? v.map(plain) : v;
      return hexes.map((hex) => plain(decode(hex)));
    }"""

    def plain(value: Any) -> Any:
        if isinstance(value, bytes):
            return "b" + value.hex()
        if isinstance(value, dict):
            return sorted(([plain(key), plain(item)] for key, item in value.items()), key=str)
        if isinstance(value, list):
            return [plain(item) for item in value]
        is_large = isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 1 << 53
        return str(value) if is_large else value

    def ordered(value: Any) -> Any:
        return sorted(value, key=str) if isinstance(value, list) and value and isinstance(value[0], list) else value

    read = await page.evaluate(script, [encode_value(value).hex() for value in VALUES])
    assert [ordered(value) for value in read] == [plain(value) for value in VALUES]


async def test_a_session_that_ends_is_told_and_a_new_link_opens_the_explorer_again(
    pages: Pages, watch: Watch, recorded_network: RecordedNetwork
) -> None:
    watch.expect("status of 401")
    page = await pages.open()
    served = await enter(page, recorded_network.network)
    served.end_sessions()
    await refuse_something(recorded_network)
    await expect(page.locator("#ended")).to_be_visible(timeout=20_000)
    await expect(page.locator("#ended")).to_contain_text("blockrobot explore --node node-1")
    await expect(page.locator("#blocks tbody tr").first).to_be_visible()
    await page.goto((await served.new_link()).as_uri(), wait_until="commit")
    await expect(page.locator("#state")).to_have_text("your session")
    await expect(page.locator("#ended")).to_be_hidden()


@pytest.mark.smoke
async def test_a_public_explorer_shows_headers_producers_and_counts_and_nothing_else(
    page: Page, recorded_network: RecordedNetwork, public_url: str
) -> None:
    for _ in range(SHOWN_COUNT):
        place = await refuse_something(recorded_network)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url.partition("/v1/")[2]))
    await page.goto(public_url)
    await expect(page.locator("#state")).to_have_text("public explorer")
    assert await page.locator("#nav a").all_inner_texts() == ["Live", "Producers"]
    await expect(page.locator("main")).to_contain_text("2 organisations, 4 nodes, 4 producers")
    await go(page, f"block/{place['height']}")
    await expect(page.locator("main")).to_contain_text("What they say is for members of the network.")
    for member_page in ("contracts", "members", "custody", "governance", f"tx/{place['txid']}", "contract/identity"):
        await go(page, member_page)
        await expect(page.locator("h1")).to_have_text("This is for members")
    await go(page, f"search/{place['block_id']}")
    await expect(page.locator("#found")).to_contain_text(f"Block {place['height']}")
    await go(page, "producers")
    await expect(page.locator("main")).to_contain_text("node-4")
    for scheme in ("dark", "light"):
        await page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        for place_shown in ("producers", "live"):
            await go(page, place_shown)
            for width, height in (ZOOMED, NARROW, WIDE):
                await page.set_viewport_size({"width": width, "height": height})
                assert await find_accessibility_faults(page, by_keyboard=False) == []
    await shoot_all_ways(page, "explorer-public")
    assert not [path for path in asked if path and not path.startswith("explorer/")]
    await page.get_by_role("button", name="Hold still").click()  # Tab cannot reach what comes in behind it
    assert await find_accessibility_faults(page) == []


@pytest.mark.parametrize("size", [WIDE, NARROW, ZOOMED], ids=["wide", "narrow", "zoomed"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
async def test_every_page_can_be_read_and_used_by_everybody(
    pages: Pages, recorded_network: RecordedNetwork, size: tuple[int, int], scheme: Any
) -> None:
    place = await refuse_something(recorded_network)
    page = await pages.open(size, color_scheme=scheme)
    await enter(page, recorded_network.network)
    faults = {}
    for where in (*PLACES, f"tx/{place['txid']}", "search/node"):
        await go(page, where)
        faults[where] = await find_accessibility_faults(page, by_keyboard=(size, scheme) == (WIDE, "light"))
        if size == WIDE and scheme == "light":
            await shoot_all_ways(page, f"explorer-{where.partition('/')[0]}")
    assert {where: found for where, found in faults.items() if found} == {}
