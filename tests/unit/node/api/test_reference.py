"""The interface describes itself, and the pages made from it are current."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from openapi_spec_validator import validate

from consensus.errors import CATALOGUE
from node.api.openapi import build_openapi, errors_of
from node.api.reference import main, pages
from node.api.routes import ROUTES

FOLDER = Path(__file__).parents[4] / "docs" / "reference"


def test_the_openapi_document_is_valid() -> None:
    validate(build_openapi(ROUTES))


async def test_a_node_serves_the_document_of_its_routes(api: Any) -> None:
    document = await (await api.get("/v1/openapi.json")).json()
    assert document == build_openapi(ROUTES)
    assert {(method.upper(), path) for path, item in document["paths"].items() for method in item} == {
        (route.method, route.path) for route in ROUTES
    }


def test_routes_for_sessions_say_so_in_the_document() -> None:
    paths = build_openapi(ROUTES)["paths"]
    for route in ROUTES:
        assert bool(paths[route.path][route.method.lower()]["security"]) == route.access.needs_session


def test_every_error_a_route_names_is_in_the_catalogue() -> None:
    for route in ROUTES:
        assert set(errors_of(route)) <= set(CATALOGUE)


@pytest.mark.parametrize("name", ["http-api.md", "errors.md", "authorisation.md"])
def test_the_reference_page_is_current(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == pages()[name], (
        "run: python -m node.api.reference docs/reference"
    )


def test_the_check_tells_a_stale_page(tmp_path: Path) -> None:
    assert main([str(tmp_path)]) == 0
    assert main([str(tmp_path), "--check"]) == 0
    (tmp_path / "errors.md").write_text("old")
    assert main([str(tmp_path), "--check"]) == 1
