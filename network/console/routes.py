"""HTTP routes of the console's page.

`pages/local_page.py` has checked host, origin and session before anything here is called.
"""

from __future__ import annotations

from datetime import UTC, datetime

import msgspec
from aiohttp import web

from consensus.errors import BlockRobotError
from network.console.live import LiveConsole, describe_plan
from pages.local_page import LocalRoute, read_object

NEWS_WAIT_S = 5.0
PLAN_MAX_CHARS = 256 * 1024


def console_routes(console: LiveConsole) -> list[LocalRoute]:
    async def choices(_request: web.Request) -> web.Response:
        return _tell(console.choices())

    async def now(request: web.Request) -> web.Response:
        await console.wait_beyond(_number(request, "after"), NEWS_WAIT_S)
        return _tell(console.now(_number(request, "events")))

    async def past(request: web.Request) -> web.Response:
        return _tell(console.past(_number(request, "at_ms")))

    async def fault(request: web.Request) -> web.Response:
        return web.json_response({"done": await console.do(await read_object(request))})

    async def check_plan(request: web.Request) -> web.Response:
        return _tell(describe_plan(console.read_plan(await _plan_text(request))))

    async def start_plan(request: web.Request) -> web.Response:
        return _tell(console.start_plan(await _plan_text(request)), status=202)

    async def stop_plan(_request: web.Request) -> web.Response:
        console.stop_plan()
        return web.json_response({"stopped": True})

    async def export(_request: web.Request) -> web.Response:
        """Return the run so far as bytes, never as a page of this origin."""
        name = f"blockrobot-run-{datetime.now(UTC):%Y%m%d-%H%M%S}.html"
        headers = {"Content-Disposition": f'attachment; filename="{name}"'}
        return web.Response(body=console.export().encode(), content_type="application/octet-stream", headers=headers)

    return [
        LocalRoute("GET", "/api/choices", choices),
        LocalRoute("GET", "/api/now", now),
        LocalRoute("GET", "/api/past", past),
        LocalRoute("POST", "/api/faults", fault),
        LocalRoute("POST", "/api/plans/check", check_plan),
        LocalRoute("POST", "/api/plans", start_plan),
        LocalRoute("POST", "/api/plans/stop", stop_plan),
        LocalRoute("POST", "/api/export", export),
    ]


def _tell(told: msgspec.Struct, status: int = 200) -> web.Response:
    return web.json_response(body=msgspec.json.encode(told), status=status)


def _number(request: web.Request, name: str) -> int:
    text = request.query.get(name, "0")
    if not text.isascii() or not text.isdigit() or len(text) > 15:
        raise BlockRobotError("REQUEST_INVALID", f"{name} is no whole number.")
    return int(text)


async def _plan_text(request: web.Request) -> str:
    text = (await read_object(request)).get("text")
    if not isinstance(text, str) or len(text) > PLAN_MAX_CHARS:
        raise BlockRobotError("REQUEST_INVALID", f"A plan is a text of up to {PLAN_MAX_CHARS} characters.")
    return text
