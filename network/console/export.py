"""Writes a run as one self-contained HTML file, script and style allowed by hash."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from collections.abc import Mapping
from typing import Any

import msgspec

EXPORT_FORMAT = 1
REPLAY_MODULE = "replay.js"
STYLE_NAMES = ("shared/design.css", "console.css")
_IMPORT = re.compile(r'^import \{([^}]*)\} from "\./([^"]+)";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async function|function|const|class) (\w+))", re.MULTILINE)


def join_modules(modules: Mapping[str, str], entry: str) -> str:
    """With its imports. Raises ValueError if impossible."""
    joined: dict[str, str] = {}
    _join(modules, entry, joined, ())
    return "const modules = {};\n" + "".join(joined.values())


def _join(modules: Mapping[str, str], name: str, joined: dict[str, str], importers: tuple[str, ...]) -> None:
    if name in joined:
        return
    if name not in modules or name in importers:
        raise ValueError(f"{name}: no such module, or it imports itself")
    text = modules[name]
    folder = name.rpartition("/")[0]

    def bind(found: re.Match[str]) -> str:
        target = f"{folder}/{found[2]}" if folder else found[2]
        _join(modules, target, joined, (*importers, name))
        names = found[1].replace(" as ", ": ")
        return f'const {{{names}}} = modules["{target}"];'

    body = _IMPORT.sub(bind, text)
    exported = _EXPORT.findall(body)
    body = _EXPORT.sub("", body)
    if re.search(r"^\s*(?:import|export)\b", body, re.MULTILINE) or re.search(r"</script|<!--", body, re.IGNORECASE):
        raise ValueError(f"{name}: an import or export of another form, or text that would end the script")
    joined[name] = f'modules["{name}"] = (() => {{\n{body}\nreturn {{{", ".join(exported)}}};\n}})();\n'


def _hash(text: str) -> str:
    return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"


def _data(value: bytes) -> str:
    """Escapes JSON against closing its HTML element."""
    return value.decode().replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def write_export(facts: Mapping[str, Any], moments_json: bytes, files: Mapping[str, str]) -> str:
    """`facts` are small JSON-ready parts, `moments_json` the moments' array, `files` modules and style sheets by name."""
    modules = {name: text for name, text in files.items() if name.endswith(".js")}
    script = "\n" + join_modules(modules, REPLAY_MODULE)
    style = "\n" + "\n".join(files[name] for name in STYLE_NAMES)
    if re.search(r"</style|@import|url\(", style, re.IGNORECASE):
        raise ValueError("a style sheet that asks for something outside")
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; base-uri 'none'; form-action 'none'"
    )
    title = html.escape(f"A run of {facts['network']['name']}")
    head = msgspec.json.encode({"format": EXPORT_FORMAT, **facts})
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="referrer" content="no-referrer">\n<title>{title}</title>\n<style>{style}</style>\n</head>\n'
        f'<body>\n<a class="skip-link" href="#main">Skip to the replay</a>\n'
        f'<div id="root"><noscript><p class="page">This file replays a run with a script of its own, '
        f"which asks nobody for anything. Allow scripts to see it.</p></noscript></div>\n"
        f'<script type="application/json" id="facts">{_data(head)}</script>\n'
        f'<script type="application/json" id="moments">{_data(moments_json)}</script>\n'
        f'<script type="module">{script}</script>\n</body>\n</html>\n'
    )
