"""What a browser does with the wallet's page, without a browser: the link, the session, questions, tasks followed."""

from __future__ import annotations

import re
from pathlib import Path
from types import TracebackType
from typing import Any

import aiohttp

SESSION_HEADER = "X-BlockRobot-Session"


def read_link(redirect_file: Path) -> tuple[str, str]:
    """Return the page's origin and the one-time token from the file that a browser is given."""
    found = re.search(r'href="(http://[0-9a-z.]+:[0-9]+)/#([A-Za-z0-9_-]+)"', redirect_file.read_text(encoding="utf-8"))
    assert found is not None
    return found[1], found[2]


class WalletPage:
    """A page that was opened. Use `async with`."""

    def __init__(self, redirect_file: Path) -> None:
        self.origin, self.token = read_link(redirect_file)
        self.headers: dict[str, str] = {"Origin": self.origin}
        self.http = aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=60))

    async def __aenter__(self) -> WalletPage:
        answer = await self.post("/session", {"token": self.token})
        self.headers[SESSION_HEADER] = answer["session"]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.http.close()

    async def ask(self, method: str, path: str, body: Any = None, **more: Any) -> tuple[int, Any]:
        """Return status and answer: JSON as it is, all else as bytes."""
        async with self.http.request(method, self.origin + path, json=body, headers=self.headers, **more) as answer:
            is_json = "json" in answer.content_type
            return answer.status, await answer.json(content_type=None) if is_json else await answer.read()

    async def get(self, path: str, **query: Any) -> Any:
        """Return what a GET answers, which has to succeed."""
        status, answer = await self.ask("GET", path, params={key: str(value) for key, value in query.items()})
        assert status == 200, (path, answer)
        return answer

    async def post(self, path: str, body: Any = None) -> Any:
        """Return what a POST answers, which has to succeed."""
        status, answer = await self.ask("POST", path, body if body is not None else {})
        assert status in {200, 202}, (path, answer)
        return answer

    async def refused(self, method: str, path: str, body: Any = None) -> str:
        """Return the code by which something is refused."""
        status, answer = await self.ask(method, path, body)
        assert status >= 400, answer
        return str(answer["code"])

    async def follow(self, accepted: dict[str, Any]) -> dict[str, Any]:
        """Return how a task ended, with every state in which it was seen under `seen`."""
        after, seen = 0, []
        while True:
            job: dict[str, Any] = await self.get(f"/api/jobs/{accepted['job']}", after=after, wait_ms=5_000)
            after = job["revision"]
            seen.append(job)
            if job["state"] in {"done", "failed", "cancelled"}:
                return job | {"seen": seen}

    async def do(self, path: str, body: Any = None) -> dict[str, Any]:
        """Do something that takes long; return its result."""
        job = await self.follow(await self.post(path, body))
        assert job["state"] == "done", job["error"]
        result: dict[str, Any] = job["result"]
        return result

    async def settle(self, is_there: Any, path: str = "/api/overview") -> Any:
        """Wait for news until an answer is as it should be; return it."""
        news = 0
        for _ in range(40):
            answer = await self.get(path)
            if is_there(answer):
                return answer
            news = (await self.get("/api/changes", after=news, wait_ms=2_000))["news"]
        raise AssertionError(answer)
