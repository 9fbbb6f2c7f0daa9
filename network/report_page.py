"""Reports as one self-contained HTML file in the common design.

Its content security policy forbids loading and scripts.
"""

from __future__ import annotations

import base64
import hashlib
import html
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pages.serving import PAGES_ASSETS

_STYLE_FILE = Path(__file__).with_name("report.css")
_XML_HEAD = re.compile(r"^.*?<svg\b", re.DOTALL)
_TITLES = re.compile(r"<title>.*?</title>", re.DOTALL)
_COMMENTS = re.compile(r"<!--.*?-->", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Section:
    """A report section: heading and HTML body. `new_sheet`: page break in print."""

    heading: str
    body: str
    new_sheet: bool = False


def text(value: object) -> str:
    """Escaped HTML."""
    return html.escape(str(value))


def build_report(title: str, lead: str, sections: Sequence[Section], *, lead_is_good: bool | None = None) -> str:
    """Return the page. `lead`: HTML summary; `lead_is_good`: its seal (None: no seal)."""
    style = (PAGES_ASSETS / "design.css").read_text(encoding="utf-8") + _STYLE_FILE.read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    links = "".join(f'<li><a href="#part-{n}">{text(one.heading)}</a></li>' for n, one in enumerate(sections, 1))
    contents = f'<nav class="card contents no-print" aria-label="Contents"><ol>{links}</ol></nav>'
    body = "".join(_section(number, one) for number, one in enumerate(sections, 1))
    seal = "" if lead_is_good is None else f' class="seal {"good" if lead_is_good else "bad"}"'
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{text(title)}</title><style>{style}</style></head>"
        '<body><a class="skip-link" href="#report">To the report</a>'
        f'<main class="page" id="report"><h1>{text(title)}</h1><div{seal}><div>{lead}</div></div>'
        f"{contents if len(sections) > 1 else ''}{body}</main></body></html>\n"
    )


def _section(number: int, section: Section) -> str:
    kind = ' class="new-sheet"' if section.new_sheet else ""
    heading = f'<h2 id="part-{number}">{text(section.heading)}</h2>'
    return f'<section{kind} aria-labelledby="part-{number}">{heading}{section.body}</section>'


def table(
    caption: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    numbers_from: int = 1,
    stacked: bool = False,
) -> str:
    """Return a table of HTML cells; columns from `numbers_from` are right-aligned.

    `stacked`: on narrow screens a row's last cell is below the others.
    """
    mark = ["" if place < numbers_from else ' class="number"' for place in range(len(headings))]
    head = "".join(
        f'<th scope="col"{kind}>{cell or _unseen("what")}</th>' for kind, cell in zip(mark, headings, strict=True)
    )
    lines = ["".join(f"<td{kind}>{cell}</td>" for kind, cell in zip(mark, row, strict=True)) for row in rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{text(caption)}">'
        f'<table class="list{" stacked" if stacked else ""}"><caption><span>{text(caption)}</span></caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _unseen(words: str) -> str:
    return f'<span class="visually-hidden">{text(words)}</span>'


def badge(*, ok: bool) -> str:
    return '<span class="badge good">held</span>' if ok else '<span class="badge bad">FAILED</span>'


def tiles(figures: Sequence[tuple[str, str]]) -> str:
    cards = "".join(
        f'<div class="card"><p class="figure">{text(v)}</p><p class="quiet">{text(n)}</p></div>' for v, n in figures
    )
    return f'<div class="grid tiles">{cards}</div>'


def quiet(words: str) -> str:
    """Return a remark; `words` is HTML."""
    return f'<p class="quiet">{words}</p>'


def picture(png: bytes, *, alternative: str, caption: str) -> str:
    data = base64.b64encode(png).decode()
    return (
        f'<figure class="card"><img alt="{text(alternative)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{text(caption)}</figcaption></figure>"
    )


def gallery(figures: Sequence[str]) -> str:
    return f'<div class="grid gallery">{"".join(figures)}</div>'


def bar(value: float, longest: float, series: int) -> str:
    width = 100 * value / longest if longest else 0
    return (
        '<svg class="length" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true">'
        f'<rect class="series-{series}" width="{width:.2f}" height="8"/></svg>'
    )


def drawing(svg: str, *, name: str, alternative: str) -> str:
    """Return an SVG on white with alternative text; `name` labels its scrollable region."""
    plain = _COMMENTS.sub("", _TITLES.sub("", _XML_HEAD.sub("<svg", svg, count=1)))
    plain = re.sub(r'\s(?:role|aria-label)="[^"]*"', "", plain)
    named = plain.replace("<svg", f'<svg role="img" aria-label="{text(alternative)}"', 1)
    return f'<div class="scroll paper" tabindex="0" role="region" aria-label="{text(name)}">{named}</div>'
