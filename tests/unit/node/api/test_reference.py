"""The interface describes itself, and the pages made from it are current."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from openapi_spec_validator import validate

from consensus.errors import CATALOGUE
from consensus.state.keys import ListRow, Row
from consensus.state.layout import LAYOUT, MODULES
from node.api.openapi.openapi_document import build_openapi, errors_of
from node.api.openapi.reference_pages import main, pages
from node.api.ports import CustodyService, ReceiptIssuer, UploadAdmissionService
from node.api.routes import ROUTES
from node.api.state_page import describe_rows
from node.execution.execution_machines import ViewRunner

FOLDER = Path(__file__).parents[4] / "docs" / "reference"


async def test_the_openapi_document_is_valid_and_of_the_routes_that_a_node_serves(api: Any) -> None:
    validate(build_openapi(ROUTES))
    document = await (await api.get("/v1/openapi.json")).json()
    assert document == build_openapi(ROUTES)
    assert {(method.upper(), path) for path, item in document["paths"].items() for method in item} == {
        (route.method, route.path) for route in ROUTES
    }
    paths = build_openapi(ROUTES)["paths"]
    for route in ROUTES:
        assert bool(paths[route.path][route.method.lower()]["security"]) == route.access.needs_session
    for route in ROUTES:
        assert set(errors_of(route)) <= set(CATALOGUE)


@pytest.mark.parametrize(
    ("operation", "asked"),
    [
        ("uploadClip", (UploadAdmissionService.clip, CustodyService.stage)),
        ("downloadClip", (CustodyService.download,)),
        ("uploadKeyPart", (CustodyService.stage_part,)),
        ("downloadSharedClip", (CustodyService.download, CustodyService.download_shared)),
        ("putBackground", (UploadAdmissionService.background, CustodyService.put_background)),
        ("getBackground", (CustodyService.get_background,)),
        ("signConsentReceipt", (ReceiptIssuer.issue,)),
        ("queryContract", (ViewRunner.run_view,)),
    ],
)
def test_a_route_names_what_the_services_raise_that_it_asks(operation: str, asked: tuple[Any, ...]) -> None:
    (route,) = (route for route in ROUTES if route.operation == operation)
    raised = {code for service in asked for code in re.findall(r"[A-Z]+(?:_[A-Z]+)+", str(service.__doc__))}
    assert raised & CATALOGUE.keys()
    assert sorted(raised & CATALOGUE.keys() - set(errors_of(route))) == []


@pytest.mark.parametrize("name", ["http-api.md", "errors.md", "authorisation.md", "state.md"])
def test_the_reference_page_is_current(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == pages()[name], (
        "run: python -m node.api.openapi.reference_pages docs/reference"
    )


def test_the_check_tells_a_stale_page(tmp_path: Path) -> None:
    assert main([str(tmp_path)]) == 0
    assert main([str(tmp_path), "--check"]) == 0
    (tmp_path / "errors.md").write_text("old")
    assert main([str(tmp_path), "--check"]) == 1


def test_the_page_of_the_state_has_every_key_and_row_and_says_what_a_value_means_that_is_no_row() -> None:
    told = [each for module in MODULES for each in describe_rows(module)]
    assert [rows for rows, _ in told] == list(LAYOUT)
    is_row = {rows.name: isinstance(rows.kind, type) and issubclass(rows.kind, (Row, ListRow)) for rows in LAYOUT}
    assert [rows.name for rows, words in told if not words and not is_row[rows.name]] == []
    text = pages()["state.md"]
    headings = re.findall(r"^### `(\w+)`$", text, re.MULTILINE)
    assert len(set(headings)) == len(headings)
    assert set(re.findall(r"\]\(#(\w+)\)", text)) == {name.lower() for name in headings}
