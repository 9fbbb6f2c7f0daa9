"""Every listener is opened in one place, which holds a table of its connections and leaves descriptors over."""

from __future__ import annotations

import re

from tests.architecture.test_tidy import ROOT, matches, modules

LISTENING = ROOT / "pages" / "listening.py"
ATTACKER = ROOT / "network" / "bench" / "flood" / "flood_attacker.py"
OPENS = re.compile(
    r"\b(?:AppRunner|ServerRunner|TCPSite|SockSite|UnixSite|NamedPipeSite|run_app)\b"
    r"|\b(?:start_server|start_unix_server|create_server|create_unix_server)\(|\.listen\(\w*COUNT\)|\.listen\(\d*\)"
    r"|\b(?:HTTPServer|TCPServer|ThreadingHTTPServer|UnixStreamServer)\b"
)
TAKES = re.compile(r"\bsock_accept\(|\.accept\(\)")


def test_one_module_opens_listeners_and_one_function_accepts_connections() -> None:
    """The flood bench plays a node whose certificate was stolen: it has no one to protect."""
    assert matches([path for path in modules() if path not in (LISTENING, ATTACKER)], OPENS) == []
    assert len(matches([LISTENING], OPENS)) == 3, "the system's queue, the type of aiohttp's runner, and one of it"
    assert len(matches([path for path in modules() if path != ATTACKER], TAKES)) == 1
