"""A local page has an origin of its own: nothing that the browser keeps of the port's former user is in it."""

from __future__ import annotations

from pathlib import Path

import pytest
from aiohttp import web
from playwright.async_api import Page, expect

from pages import local_page
from pages.listening import open_listener, serve
from pages.local_page import LocalPage
from pages.serving import Assets

_REGISTER = """<!doctype html><title>not yet</title><link rel="icon" href="data:,"><script>
  navigator.serviceWorker.register('/worker.js').then(() => navigator.serviceWorker.ready).then(() => {
    document.title = 'registered';
  });
</script>"""
_WORKER = """
  self.addEventListener('install', () => self.skipWaiting());
  self.addEventListener('activate', (event) => event.waitUntil(clients.claim()));
  self.addEventListener('fetch', (event) => event.respondWith(
    new Response('<!doctype html><title>taken</title>', { headers: { 'Content-Type': 'text/html' } })));
"""


def _worker_host() -> web.Application:
    """What another user of the machine serves."""
    application = web.Application()
    for path, text, kind in (("/", _REGISTER, "text/html"), ("/worker.js", _WORKER, "text/javascript")):

        async def answer(_request: web.Request, text: str = text, kind: str = kind) -> web.Response:
            return web.Response(text=text, content_type=kind)

        application.router.add_get(path, answer)
    return application


@pytest.mark.smoke
async def test_a_service_worker_of_the_ports_former_user_does_not_answer_for_the_page(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listener = open_listener("127.0.0.1", 0)
    port = listener.getsockname()[1]
    async with serve(_worker_host(), listener, 10, 100):
        await page.goto(f"http://127.0.0.1:{port}/")
        await expect(page).to_have_title("registered")
    await page.goto(f"http://127.0.0.1:{port}/")
    await expect(page).to_have_title("taken")  # nobody listens there any more

    (tmp_path / "index.html").write_text('<!doctype html><title>mine</title><link rel="icon" href="icon.svg">')
    (tmp_path / "icon.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
    monkeypatch.setattr(local_page, "open_listener", lambda host, _port: open_listener(host, port))
    async with LocalPage(Assets(tmp_path), (), redirect_folder=tmp_path / "links", title="mine") as mine:
        assert mine.url.endswith(f":{port}/")
        await page.goto((await mine.new_link()).as_uri(), wait_until="commit")
        await page.wait_for_url(f"{mine.url}#*")
        await expect(page).to_have_title("mine")
        assert await page.evaluate("[isSecureContext, navigator.serviceWorker.controller]") == [True, None]
        assert await page.evaluate("navigator.serviceWorker.getRegistrations().then((all) => all.length)") == 0
