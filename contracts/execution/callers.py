"""Caller rules from "Who may call: ..." in shipped contracts' docstrings, tested for every role."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from consensus.errors import BlockRobotError
from contracts.lifecycle.registry import SHIPPED_CONTRACTS, load_contracts, read_source

STRANGER = "stranger"
FORMER = "former"
MEMBERS = frozenset({"subject", "staff", "robot", "officer", "auditor"})
RECORDED = frozenset({"subject", "staff"})
REPRESENTING = RECORDED | {"officer"}
ROLES: Mapping[str, str] = MappingProxyType(
    {
        STRANGER: "a key that the chain does not know, or a visit's owner key that was replaced",
        "subject": "a subject",
        "staff": "a member of the staff",
        "robot": "a robot",
        "officer": "a data protection officer",
        "auditor": "an auditor",
        "registrar": "a registrar",
        "admin": "an admin of an active organisation",
        "custodian": "a custodian's node",
        "producer": "a producer",
        "candidate": "a candidate without a seat, or a suspended producer",
        "owner": "a visit's owner key",
        "grantee": "a grantee's one-time key",
        FORMER: "a revoked member, or an admin or producer that was removed",
    }
)
"""The roles of a transaction's sender, with what each is."""

NOT_YET_MEMBERS = frozenset(ROLES) - MEMBERS - {FORMER}
_NOBODY: frozenset[str] = frozenset()
_WORDS = re.compile(r"Who may call: (.+?)\.(?:\s|$)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class CallerRule:
    """Allowed roles: always, for their own, and contracts for a caller."""

    words: str
    always: frozenset[str] = _NOBODY
    own: frozenset[str] = _NOBODY
    contracts: frozenset[str] = _NOBODY

    @property
    def roles(self) -> frozenset[str]:
        return self.always | self.own


def _own(*roles: str) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    return _NOBODY, frozenset(roles), _NOBODY


def _always(*roles: str) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    return frozenset(roles), _NOBODY, _NOBODY


def _contracts(*names: str) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    return _NOBODY, _NOBODY, frozenset(names)


_RULES: dict[str, tuple[frozenset[str], frozenset[str], frozenset[str]]] = {
    "a robot": _always("robot"),
    "the robot that opened it": _own("robot"),
    "the robot that opened the owner's visit, while it is open": _own("robot"),
    "the visit's owner key": _own("owner"),
    "the visit's owner key, with the new key's agreement": _own("owner"),
    "the record's owner key": _own("owner"),
    "the records' owner key": _own("owner"),
    "its owner key": _own("owner"),
    "the grantee's key of the grant": _own("grantee"),
    "a custodian": _always("custodian"),
    "a custodian, once": _always("custodian"),
    "a custodian, once for each record": _always("custodian"),
    "a custodian of the request, once": _own("custodian"),
    "the organisation's officers": _own("officer"),
    "an officer of the robot's organisation": _own("officer"),
    "an officer or admin of the robot's organisation": _own("admin", "officer"),
    "an officer or admin of the robot's organisation, or an admin of another once that one was removed": _own(
        "admin", "officer"
    ),
    "another officer of the robot's organisation": _own("officer"),
    "either of the two officers": _own("officer"),
    "an officer of the represented member's organisation": _own("officer"),
    "another officer of the represented member's organisation": _own("officer"),
    "the representative it names": _own(*REPRESENTING),
    "the represented, the representative, or an officer of the organisation": _own(*REPRESENTING),
    "an active member": _always(*MEMBERS),
    "the person of the handle, or who acts for them by a mandate": _own(*REPRESENTING),
    "the member of the handle": _own(*MEMBERS),
    "the member of the handle, with the new key's agreement": _own(*MEMBERS),
    "whoever holds the card's key, under a registrar's voucher": _own(*NOT_YET_MEMBERS),
    "an admin or registrar of the member's organisation": _own("admin", "registrar"),
    "an admin of an active organisation": _always("admin"),
    "an admin of an active organisation that votes for it": _own("admin"),
    "an admin of the organisation that proposed it": _own("admin"),
    "a candidate that has no seat": _always("candidate"),
    "a producer or candidate": _always("producer", "candidate"),
    "the contract `consent`": _contracts("consent"),
    "the contract `erasure`": _contracts("erasure"),
    "the contract `identity`": _contracts("identity"),
    "the contract `lifecycle`": _contracts("lifecycle"),
    "the contract `mandates`": _contracts("mandates"),
    "the contract `membership`": _contracts("membership"),
    "the contracts by which officers decide": _contracts("officers", "rights"),
    "the contract `rights`, for themselves": _contracts("rights"),
    "the contract `settings`": _contracts("settings"),
    "the contract `settings`, which checks the value": _contracts("settings"),
    "the contracts that decide of visits": _contracts("access", "erasure", "officers", "records", "rights"),
}
_AT_GENESIS = CallerRule("nobody: it is called once, while the first state is made")


def rule_of(contract: str, entry: str, docstring: str) -> CallerRule:
    """Parse a docstring's rule. Raises CONFIGURATION_INVALID."""
    found = _WORDS.search(docstring)
    words = " ".join(found.group(1).split()) if found else ""
    if words not in _RULES:
        problem = f"says {words!r}, which no rule is known for" if words else "does not say who may call it"
        raise BlockRobotError("CONFIGURATION_INVALID", f"The entry {contract}.{entry} {problem}.")
    return CallerRule(words, *_RULES[words])


@cache
def entry_rules() -> Mapping[tuple[str, str], CallerRule]:
    """Return rules of state-changing entries by (contract, entry). Raises CONFIGURATION_INVALID."""
    contracts, rules = load_contracts(), {}
    for name in SHIPPED_CONTRACTS:
        tree = ast.parse(read_source(name))
        texts = {node.name: ast.get_docstring(node) or "" for node in tree.body if isinstance(node, ast.FunctionDef)}
        for entry in contracts[name].abi.entries:
            if entry.kind == "genesis":
                rules[name, entry.name] = _AT_GENESIS
            elif entry.kind != "view":
                rules[name, entry.name] = rule_of(name, entry.name, texts[entry.name])
    return MappingProxyType(rules)
