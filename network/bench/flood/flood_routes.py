"""Floods of body-less requests: every GET at its dearest, and unknown routes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from network.bench.flood.flood_kinds import FRAMES, HANDSHAKES, HttpFlood, Identity, Target
from network.bench.flood.flood_kinds import ROUTES as BODIES
from node.api.routes import ROUTES
from node.api.routing import JSON, SSE, Parameter, Route

READS: Mapping[str, Route] = {route.operation: route for route in ROUTES if route.method == "GET"}
FILTERED = ":filtered"
"""Asks for what nothing matches, so that all that may be looked through is."""
_NO_CONTRACT = "nothing"
_MOST = frozenset({"limit", "evidence"})
_DEFAULTS = frozenset({"wait_ms", "after", "after_height", "version", "contract", "name"})
STRAYS: Mapping[str, HttpFlood] = {
    "stray:path": HttpFlood("GET", "/nowhere", JSON, lambda _target: b""),
    "stray:method": HttpFlood("DELETE", "/v1/genesis", JSON, lambda _target: b""),
    "stray:expectation": HttpFlood("GET", "/nowhere", JSON, lambda _target: b"", headers="Expect: wonders\r\n"),
    "stray:malformed": HttpFlood("GE T", "/v1/genesis", JSON, lambda _target: b""),
}
"""Answers that are of no route."""


@dataclass(frozen=True, slots=True)
class CostlyTargets:
    """Costly request targets: where full blocks begin, the fullest block, its transaction."""

    window: int
    height: int
    txid: str
    block_id: str


def read_kinds() -> list[str]:
    filtered = [name + FILTERED for name, route in READS.items() if _asks(route, "contract")]
    return sorted([*READS, *filtered])


def make_read(kind: str, landmarks: CostlyTargets) -> HttpFlood:
    route = READS[kind.removesuffix(FILTERED)]
    values = _values(route, landmarks)
    path, query = route.path, []
    for parameter in route.parameters:
        if parameter.place == "path":
            path = path.replace(f"{{{parameter.name}}}", _required(values, route, parameter))
        elif parameter.name in _MOST:
            query.append(f"{parameter.name}={parameter.maximum}")
        elif kind.endswith(FILTERED) and parameter.name == "contract":
            query.append(f"contract={_NO_CONTRACT}")
        elif parameter.name not in _DEFAULTS:
            query.append(f"{parameter.name}={_required(values, route, parameter)}")
    path += "?" + "&".join(query) if query else ""
    return HttpFlood(route.method, path, JSON, _no_body, streams=route.answer.media_type == SSE)


def _values(route: Route, landmarks: CostlyTargets) -> dict[str, str]:
    place = f"{landmarks.window}:0"
    names = {"getContract": "records", "getExplorerFile": "api.js", "getSharedFile": "dom.js"}
    return {
        "txid": landmarks.txid,
        "height": str(landmarks.height),
        "from_height": str(landmarks.window),
        "from": place if route.operation == "listEvents" else "0",
        "cursor": place,
        "block_id": landmarks.block_id,
        "record_id": "00" * 16,
        "access_id": "00" * 32,
        "sha256": "00" * 32,
        "number": "0",
        "code": "NOT_PERMITTED",
        "name": names.get(route.operation, ""),
    }


def _required(values: Mapping[str, str], route: Route, parameter: Parameter) -> str:
    value = values.get(parameter.name)
    if not value:
        raise KeyError(f"no flood has a value for {parameter.name} of {route.operation}")
    return value


def _asks(route: Route, name: str) -> bool:
    return any(parameter.name == name for parameter in route.parameters)


def _no_body(_target: Target) -> bytes:
    return b""


def kinds_of(identity: Identity) -> list[str]:
    if identity == "node":
        return list(FRAMES)
    asked = [*BODIES, *read_kinds(), *STRAYS]
    return [*asked, HANDSHAKES] if identity == "stranger" else asked


def http_flood(kind: str, landmarks: CostlyTargets) -> HttpFlood:
    found = BODIES.get(kind) or STRAYS.get(kind)
    return make_read(kind, landmarks) if found is None else found
