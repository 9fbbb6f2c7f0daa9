"""Times are shown to people in one way: in 24 hours, with their zone, by pages/time_format.py and pages/assets/format.js.

And distances in one scale of colours: by clients/sdk/pictures/depth_colours.py.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.architecture.test_tidy import PACKAGES, ROOT, modules

_MOMENTS = "pages/time_format.py"
_FORMATS = {"strftime", "isoformat", "ctime", "asctime", "localtime", "gmtime", "fromtimestamp", "utcfromtimestamp"}
_TIME_FORMAT = re.compile(r"%[aAbBcdHIjmMpSUwWxXyYZ]")
NOT_SHOWN = {
    _MOMENTS: "the one place",
    "clients/robot/recording/event_log.py": "XES, a file format, wants ISO 8601",
    "clients/wallet/page/record_days.py": "computes days in the zone of the page",
    "network/console/routes.py": "the name of a file",
}
"""Modules that make or write times for programs, and what for."""

_SCRIPT_FORMATS = re.compile(
    r"timeStyle|hourCycle|hour12|\bhour: ?['\"]|\bminute: ?['\"]|toLocaleTimeString|toLocaleDateString|toTimeString"
    r"|toUTCString|getHours\(\)|getUTCHours|getMinutes\(\)|getTimezoneOffset|new Date\([^)]*\)\.toLocaleString"
)
SCRIPTS = {
    "pages/assets/format.js": "the one place",
    "clients/bundle/texts.py": "a page that is part of a file format, and so has its own",
    "clients/wallet/page/assets/day.js": "getHours: sorts meetings into parts of the day",
}


def formats_a_time(tree: ast.AST) -> Iterator[int]:
    """Yield the lines on which a time becomes text, or a number becomes a time."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(attr=name)) if name in _FORMATS:
                yield node.lineno
            case ast.FormattedValue(format_spec=ast.JoinedStr(values=[ast.Constant(value=str(spec)), *_])) if (
                _TIME_FORMAT.search(spec)
            ):
                yield node.lineno


@pytest.mark.parametrize(
    "source", ["x.strftime('%H')", "f'{x:%Y-%m-%d}'", "datetime.datetime.fromtimestamp(1)", "d.isoformat()"]
)
def test_the_search_finds_each_way(source: str) -> None:
    assert list(formats_a_time(ast.parse(source))) == [1]


def test_the_search_takes_no_percentage_for_a_time() -> None:
    assert list(formats_a_time(ast.parse("f'{share:.1%} {name:>8} {time_ms:,}'"))) == []


def test_every_time_is_shown_by_the_one_module() -> None:
    found: dict[str, list[int]] = {}
    for path in modules():
        lines = list(formats_a_time(ast.parse(path.read_text("utf-8"))))
        if lines:
            found[str(path.relative_to(ROOT))] = lines
    assert {name: lines for name, lines in found.items() if name not in NOT_SHOWN} == {}
    assert set(NOT_SHOWN) <= set(found), "an exception that nobody needs"


def test_every_page_shows_times_by_the_one_script() -> None:
    paths = [
        path for package in PACKAGES for suffix in ("*.js", "*.html", "*.py") for path in (ROOT / package).rglob(suffix)
    ]
    texts = {path: path.read_text("utf-8") for path in paths}
    pages = {path: text for path, text in texts.items() if path.suffix != ".py" or "<script" in text}
    found = {str(path.relative_to(ROOT)) for path, text in pages.items() if _SCRIPT_FORMATS.search(text)}
    assert found == set(SCRIPTS)


def test_distances_have_one_scale_of_colours() -> None:
    table = re.compile(r"COLORMAP_|applyColorMap|fde725|30123b", re.IGNORECASE)
    found = {
        str(path.relative_to(ROOT))
        for package in (*PACKAGES, "docs")
        for path in (ROOT / package).rglob("*")
        if path.suffix in {".py", ".js", ".css", ".html", ".toml", ".md"} and table.search(path.read_text("utf-8"))
    }
    assert found == {"clients/sdk/pictures/depth_colours.py"}
