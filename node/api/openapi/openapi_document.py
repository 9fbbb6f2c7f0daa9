"""The OpenAPI 3.1 document, made from the route table."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from consensus.api_documents import Document, Problem
from consensus.errors import CATALOGUE
from node.api.problems import PROBLEM_TYPE
from node.api.routing import Answer, Body, Parameter, Route

API_VERSION = "1.0.0"
EVERY_ROUTE_ERRORS = ("REQUEST_INVALID", "RATE_LIMITED", "STORAGE_BUSY", "STORAGE_DAMAGED", "INTERNAL")
SESSION_ERRORS = ("SESSION_REQUIRED", "SESSION_EXPIRED", "SESSION_REFUSED", "NOT_PERMITTED")
BODY_ERRORS = ("REQUEST_TOO_LARGE", "REQUEST_TIMEOUT", "MEDIA_TYPE_UNSUPPORTED")
Schema = dict[str, Any]
_SCHEMA_PLACE = "#/components/schemas/{name}"


def errors_of(route: Route) -> tuple[str, ...]:
    codes = {*EVERY_ROUTE_ERRORS, *route.errors}
    if route.access.needs_session:
        codes |= set(SESSION_ERRORS)
    if route.body is not None:
        codes |= set(BODY_ERRORS)
    return tuple(sorted(codes))


def _parameter(parameter: Parameter) -> Schema:
    if parameter.size_bytes is not None:
        schema: Schema = {"type": "string", "pattern": f"^[0-9a-f]{{{2 * parameter.size_bytes}}}$"}
    elif parameter.pattern is not None:
        schema = {"type": "string", "pattern": parameter.pattern}
    else:
        schema = {"type": "integer", "minimum": parameter.minimum, "maximum": parameter.maximum}
        if parameter.default is not None:
            schema["default"] = parameter.default
    return {
        "name": parameter.name,
        "in": parameter.place,
        "required": parameter.required,
        "description": parameter.description,
        "schema": schema,
    }


def _content(part: Body | Answer) -> Schema:
    schema: Schema = {}
    if part.kind is not None:
        schema = {"$ref": _SCHEMA_PLACE.format(name=part.kind.__name__)}
    elif part.media_type == "application/json":
        schema = {"type": "object"}
    return {part.media_type: {"schema": schema}}


def _responses(route: Route) -> Schema:
    answer = route.answer
    responses: Schema = {str(answer.status): {"description": answer.description}}
    if answer.status != 204:
        responses[str(answer.status)]["content"] = _content(answer)
    by_status: dict[int, list[str]] = {}
    for code in errors_of(route):
        by_status.setdefault(CATALOGUE[code].status, []).append(code)
    for status, codes in sorted(by_status.items()):
        responses[str(status)] = {
            "description": ", ".join(codes),
            "content": {PROBLEM_TYPE: {"schema": {"$ref": _SCHEMA_PLACE.format(name="Problem")}}},
        }
    return responses


def _operation(route: Route) -> Schema:
    operation: Schema = {
        "operationId": route.operation,
        "summary": route.summary,
        "description": f"For: {route.access.label}.",
        "responses": _responses(route),
        "security": [{"session": []}] if route.access.needs_session else [],
    }
    if route.parameters:
        operation["parameters"] = [_parameter(parameter) for parameter in route.parameters]
    if route.body is not None:
        operation["requestBody"] = {
            "required": True,
            "description": f"{route.body.description} At most {route.body.max_bytes} bytes.",
            "content": _content(route.body),
        }
    return operation


def _document_kinds(routes: Iterable[Route]) -> list[type[Document]]:
    kinds: set[type[Document]] = {Problem}
    for route in routes:
        for part in (route.body, route.answer):
            if part is not None and part.kind is not None:
                kinds.add(part.kind)
    return sorted(kinds, key=lambda kind: kind.__name__)


def build_openapi(routes: Iterable[Route]) -> Schema:
    routes = tuple(routes)
    _, schemas = msgspec.json.schema_components(_document_kinds(routes), ref_template=_SCHEMA_PLACE)
    paths: dict[str, Schema] = {}
    for route in routes:
        paths.setdefault(route.path, {})[route.method.lower()] = _operation(route)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "BlockRobot node",
            "version": API_VERSION,
            "description": "Bytes are lower-case hexadecimal in JSON. Refusals are problem documents (RFC 9457).",
        },
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {"session": {"type": "http", "scheme": "bearer"}},
        },
    }
