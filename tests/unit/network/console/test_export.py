"""An exported run is one file that asks nobody for anything."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from typing import Any

import pytest

from network.console.export import join_modules, write_export
from network.console.live import read_page_files

FACTS: dict[str, Any] = {
    "network": {"name": "a <b> & c", "quorum": 3, "nodes": []},
    "exported_ms": 1,
    "recording": {"dropped": {"words": ""}},
    "events": [{"text": "</script><script>alert(1)</script><!-- \u2028", "kind": "node"}],
    "rounds": [],
}


def _export() -> str:
    return write_export(FACTS, b'[{"at_ms":1,"text":"</script>"}]', read_page_files())


def _element(text: str, pattern: str) -> str:
    found = re.findall(pattern, text, re.DOTALL)
    assert len(found) == 1
    return str(found[0])


def test_what_a_network_calls_itself_ends_no_element() -> None:
    text = _export()
    assert "<title>A run of a &lt;b&gt; &amp; c</title>" in text
    assert len(re.findall("</script", text)) == 3
    assert "<!--" not in text
    facts = json.loads(_element(text, '<script type="application/json" id="facts">(.*?)</script>'))
    assert facts["events"] == FACTS["events"]
    assert facts["format"] == 1
    moments = json.loads(_element(text, '<script type="application/json" id="moments">(.*?)</script>'))
    assert moments == [{"at_ms": 1, "text": "</script>"}]


def test_its_policy_allows_its_own_script_and_style_and_nothing_else() -> None:
    text = _export()
    policy = _element(text, 'http-equiv="Content-Security-Policy" content="([^"]*)"')
    allowed = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    script = _element(text, '<script type="module">(.*?)</script>')
    style = _element(text, "<style>(.*?)</style>")
    for kind, content in (("script-src", script), ("style-src", style)):
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert allowed.pop(kind) == f"'sha256-{digest}'"
    assert set(allowed.values()) == {"'none'"}
    assert text.index("Content-Security-Policy") < text.index("<style>")


def test_an_export_names_nothing_outside_of_itself_and_needs_no_server() -> None:
    text = _export()
    assert not re.search(r"\b(?:src|href)=\"(?!#)", text)
    assert not re.search(r"url\(|@import|^\s*import\b|^\s*export\b", text, re.MULTILINE)
    addresses = set(re.findall(r"https?://[^\"'\s)]+", text))
    assert addresses <= {"http://www.w3.org/2000/svg"}
    script = join_modules({k: v for k, v in read_page_files().items() if k.endswith(".js")}, "replay.js")
    assert "fetching.js" not in script
    assert "fetch(" not in script


def test_modules_are_joined_each_in_a_room_of_its_own_with_what_they_import() -> None:
    modules = {
        "a.js": 'import { one as first, two } from "./shared/b.js";\nconst name = 1;\nfirst(two, name);\n',
        "shared/b.js": 'import { three } from "./c.js";\nconst name = 2;\n'
        "export function one() { return three; }\nexport const two = name;\n",
        "shared/c.js": "export const three = 3;\n",
    }
    script = join_modules(modules, "a.js")
    assert script.index('modules["shared/c.js"] =') < script.index('modules["shared/b.js"] =')
    assert 'const { one: first, two } = modules["shared/b.js"];' in script
    assert "return {one, two};" in script
    assert not re.search(r"^\s*(?:import|export)\b", script, re.MULTILINE)


@pytest.mark.parametrize(
    "modules",
    [
        {"a.js": 'import { b } from "./b.js";\n'},
        {"a.js": 'import { a } from "./b.js";\n', "b.js": 'import { b } from "./a.js";\n'},
        {"a.js": 'import * as b from "./b.js";\n', "b.js": ""},
        {"a.js": "export default 3;\n"},
        {"a.js": 'const text = "</script>";\n'},
    ],
)
def test_what_cannot_be_joined_is_refused(modules: dict[str, str]) -> None:
    with pytest.raises(ValueError, match=r"a\.js|b\.js"):
        join_modules(modules, "a.js")


def test_a_style_sheet_that_asks_for_something_outside_is_refused_and_the_page_weighs_little() -> None:
    files = read_page_files() | {"console.css": "body { background: url(x.png) }"}
    with pytest.raises(ValueError, match="outside"):
        write_export(FACTS, b"[]", files)
    assert sum(len(text.encode()) for text in read_page_files().values()) < 150_000
