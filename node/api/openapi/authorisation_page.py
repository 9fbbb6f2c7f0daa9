"""Table of who may call what, from `Route.access` and contract docstrings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from consensus.errors import BlockRobotError
from contracts.execution.callers import ROLES, CallerRule, entry_rules
from node.api.access.principals import ROLE_ADMIN, ROLE_CUSTODIAN, ROLE_REGISTRAR, Principal
from node.api.access.route_access import Access
from node.api.access.sessions import Session
from node.api.openapi.markdown_tables import write_table
from node.api.routes import ROUTES
from node.operator_listener import OPEN_PATHS, READING_PATHS

_MADE = "<!-- Made from the code by `python -m node.api.openapi.reference_pages docs/reference`. Do not edit. -->"
_INTRODUCTION = """\
Every route and every entry of a contract states who may call it, beside its code. These tables are made from those
rules; `tests/security/test_authorisation_routes.py` and `tests/security/test_authorisation_entries.py` try every cell.
A route or an entry without a rule stops the tests, and a route without one stops the node as well.

A session is opened with a key, and is worth what that key is on the finalized state at each request: a producer's key
and one who was revoked get none. Transactions need no session: each is signed, and the contract looks at the signer.

## Routes

`yes`: the request reaches the route (which may still refuse what it asks for: a clip that is another's, say).
`-`: it is refused before. Where no session counts, the code of the refusal stands below the caller; elsewhere it is
`NOT_PERMITTED`. Rows marked `(public explorer)` are those of a node whose node.toml says `[explorer] public = true`; all
others are the same there."""
_ENTRIES_INTRODUCTION = """\
## Entries of contracts

`yes`: for whatever the entry is about. `own`: for what is the caller's own, as the words say. `-`: refused, and nothing
remains but the receipt. Views (entries that only read) are not here: they are called by `POST /v1/queries`."""

_OPERATOR = """\
## The operator's listener

It listens on the node's own machine only, under the names of this machine (127.0.0.1, localhost, [::1]) and for no web
page (`NOT_PERMITTED`). It answers {paths} to whoever asks there, and {reading} to who shows the token of
`operator-read.token` in the node's data directory (mode 0600), as Prometheus does with `authorization.credentials_file`.
Whatever else there is takes the operator's token (`OPERATOR_TOKEN_INVALID`), and is for no web page (`NOT_PERMITTED`).

With `[metrics]` in `node.toml` a port of its own answers other machines {paths}, and `/metrics` to who shows that token."""


def _listed(paths: tuple[str, ...]) -> str:
    return ", ".join(f"`{path}`" for path in paths)


@dataclass(frozen=True, slots=True)
class Caller:
    """A caller: what the node knows of their key, or the refusing code."""

    name: str
    standing: Principal | None
    refused_with: str = ""


def _member(name: str, role: str = "") -> Caller:
    return Caller(name, Principal("member", frozenset({role or name})))


CALLERS = (
    Caller("no session", None, "SESSION_REQUIRED"),
    Caller("expired session", None, "SESSION_EXPIRED"),
    Caller("revoked member", None, "SESSION_REFUSED"),
    Caller("producer", None, "SESSION_REQUIRED"),
    _member("subject"),
    _member("staff"),
    _member("robot"),
    _member("officer"),
    _member("auditor"),
    _member("registrar", ROLE_REGISTRAR),
    _member("admin", ROLE_ADMIN),
    _member("custodian", ROLE_CUSTODIAN),
    Caller("owner key", Principal("owner", frozenset())),
    Caller("grantee's key", Principal("grantee", frozenset())),
    Caller("key of an ended grant", Principal("former-grantee", frozenset())),
)


def refusal_of(access: Access, caller: Caller, *, is_public: bool = False) -> str:
    if not access.asks_session(is_public=is_public):
        return ""
    if caller.standing is None:
        return caller.refused_with
    try:
        access.check(Session(bytes(33), caller.standing.kind, caller.standing.roles, 0))
    except BlockRobotError as error:
        return error.code
    return ""


def _route_cell(access: Access, *, is_public: bool) -> Callable[[Caller], str]:
    return lambda caller: "-" if refusal_of(access, caller, is_public=is_public) else "yes"


def _entry_cell(rule: CallerRule, role: str) -> str:
    if role in rule.always:
        return "yes"
    return "own" if role in rule.own else "-"


def write_authorisation_page() -> str:
    heads = [caller.name + (f"<br>`{caller.refused_with}`" if caller.refused_with else "") for caller in CALLERS]
    routes = [
        [f"`{route.method} {route.path}`{words}", *map(_route_cell(route.access, is_public=is_public), CALLERS)]
        for route in ROUTES
        for is_public, words in ((False, ""), (True, "<br>(public explorer)"))
        if route.access.opens_in_public or not is_public
    ]
    entries = [
        [f"`{contract}.{entry}`", rule.words, *(_entry_cell(rule, role) for role in ROLES)]
        for (contract, entry), rule in entry_rules().items()
    ]
    lines = [_MADE, "", "# Who may call what", "", _INTRODUCTION, "", *write_table(["route", *heads], routes), ""]
    lines += [_OPERATOR.format(paths=_listed(OPEN_PATHS), reading=_listed(READING_PATHS)), ""]
    lines += [_ENTRIES_INTRODUCTION, "", *(f"- **{role}**: {what}." for role, what in ROLES.items()), ""]
    return "\n".join(lines + write_table(["entry", "who may call", *ROLES], entries)) + "\n"
