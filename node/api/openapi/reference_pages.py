"""Generates the reference pages; `--check` only checks them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from consensus.errors import CATALOGUE
from consensus.exit_codes import exit_code_of
from node.api.openapi.authorisation_page import write_authorisation_page
from node.api.openapi.markdown_tables import write_table
from node.api.openapi.openapi_document import errors_of
from node.api.routes import ROUTES
from node.api.routing import Parameter, Route
from node.api.state_page import write_state_page

_MADE = "<!-- Made from the code by `python -m node.api.openapi.reference_pages docs/reference`. Do not edit. -->"

_HTTP_INTRODUCTION = """\
Every node serves this interface; `GET /v1/openapi.json` describes it for machines. On loopback it is plain HTTP; beyond
that it is HTTPS (TLS 1.3), by a certificate of the authority of the node's organisation, and clients take nothing else.

- **Bytes** are lower-case hexadecimal in JSON, in paths and in queries. Bodies of `application/msgpack` are the
  canonical encoding.
- **Fields**: a request with a field that the node does not know is rejected; an answer may get more fields in a later
  version, and a client passes over those that it does not know.
- **Refusals** are problem documents (`application/problem+json`): `type`, `title`, `status`, `code`, `detail`,
  `next_step`, `retryable`. The codes are in the [catalogue of errors](errors.md).
- **Sessions**: ask for a challenge, sign it, and send the token as `Authorization: Bearer TOKEN`. The signature is a
  recoverable one (65 bytes) over the tagged hash `blockrobot/session` of chain id (32 bytes), the node's name in the
  genesis file, challenge (32 bytes) and public key (33 bytes). A challenge works once, within 60 seconds; a session
  lasts ten minutes, and ends when its key loses its standing on the finalized state.
- **Finality**: a `finality` object shows that a header is final. Check it against the genesis file, and every value
  against the header's state root; `consensus/chain/light_client.py` does both. While only genesis is final it is null.
- **Epochs**: producers and settings change at boundary blocks. A proof of another epoch than the client is in
  (`PROOF_OTHER_EPOCH`) needs the steps between: `GET /v1/epochs?after=N` has them, each checked with the one before.
- **Limits**: callers without a session share a bucket of requests per address; a route's limit of body size stands
  beside it."""

_ERRORS_INTRODUCTION = """\
Every refusal of BlockRobot, on the terminal, in a log or as a problem document, has a code from this table. The
status is the one of HTTP, *exit* the exit code of a command that ends in it ([what it means](cli.md)). *Again* tells
whether the same request may succeed later or at another node."""


def _describe_parameter(parameter: Parameter) -> str:
    if parameter.size_bytes is not None:
        form = f"{parameter.size_bytes} bytes, hexadecimal"
    elif parameter.pattern is not None:
        form = f"text `{parameter.pattern}`{'' if parameter.required else ', optional'}"
    else:
        form = f"{parameter.minimum} to {parameter.maximum}"
        form += "" if parameter.default is None else f", {parameter.default} unless given"
    return f"  - `{parameter.name}` ({parameter.place}; {form}): {parameter.description}"


def _describe_route(route: Route) -> list[str]:
    lines = [f"## `{route.method} {route.path}`", "", route.summary, "", f"- **For**: {route.access.label}"]
    if route.parameters:
        lines += ["- **Parameters**:", *map(_describe_parameter, route.parameters)]
    if route.body is not None:
        kind = f" `{route.body.kind.__name__}`" if route.body.kind else ""
        lines.append(
            f"- **Body**: {route.body.media_type}{kind}, at most {route.body.max_bytes} bytes. {route.body.description}"
        )
    kind = f" `{route.answer.kind.__name__}`" if route.answer.kind else ""
    content = "" if route.answer.status == 204 else f" {route.answer.media_type}{kind}."
    lines.append(f"- **Answer**: {route.answer.status}.{content} {route.answer.description}")
    lines.append(f"- **Errors**: {', '.join(f'`{code}`' for code in errors_of(route))}")
    return [*lines, ""]


def write_http_page(routes: Iterable[Route] = ROUTES) -> str:
    routes = tuple(routes)
    lines = [_MADE, "", "# HTTP interface", "", _HTTP_INTRODUCTION, ""]
    lines += write_table(["route", "for"], [[f"`{route.method} {route.path}`", route.access.label] for route in routes])
    lines.append("")
    for route in routes:
        lines += _describe_route(route)
    return "\n".join(lines).rstrip() + "\n"


def write_errors_page() -> str:
    rows = [
        [
            f"`{entry.code}`",
            str(entry.status),
            str(exit_code_of(entry)),
            entry.meaning,
            entry.next_step,
            "yes" if entry.retryable else "no",
        ]
        for entry in sorted(CATALOGUE.values(), key=lambda entry: entry.code)
    ]
    head = ["code", "status", "exit", "meaning", "next step", "again"]
    return "\n".join([_MADE, "", "# Errors", "", _ERRORS_INTRODUCTION, "", *write_table(head, rows)]) + "\n"


def pages() -> dict[str, str]:
    return {
        "http-api.md": write_http_page(),
        "errors.md": write_errors_page(),
        "authorisation.md": write_authorisation_page(),
        "state.md": write_state_page(_MADE),
    }


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m node.api.openapi.reference_pages", description=__doc__)
    parser.add_argument("folder", type=Path, help="the folder of the pages, docs/reference in the source tree")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a page is not current")
    options = parser.parse_args(arguments)
    stale = []
    for name, text in pages().items():
        path: Path = options.folder / name
        if options.check:
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                stale.append(name)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    if stale:
        sys.stderr.write(
            f"Not current: {', '.join(stale)}. Run `python -m node.api.openapi.reference_pages {options.folder}`.\n"
        )
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
