"""The published schema: made from the types, the same in program, docs and bundles; and every bundle keeps to it."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path

import jsonschema
import pytest

from clients.bundle.documents import DOCUMENTS, FORMAT_VERSION, FORMAT_VERSIONS, make_schema
from clients.bundle.proving import schema_text
from clients.bundle.texts import README_TEXT, player_page
from tests.unit.clients.bundle.conftest import Made

ROOT = Path(__file__).resolve().parents[4]
SCHEMA = json.loads(schema_text(FORMAT_VERSION))


@pytest.mark.parametrize("version", FORMAT_VERSIONS)
def test_the_schema_is_that_of_the_types(version: int) -> None:
    assert make_schema(version) == json.loads(schema_text(version))


@pytest.mark.parametrize("version", FORMAT_VERSIONS)
def test_the_docs_publish_the_same_schema(version: int) -> None:
    place = ROOT / "docs" / "reference" / f"export-bundle-v{version}.schema.json"
    assert place.read_bytes() == schema_text(version)


@pytest.mark.parametrize("version", FORMAT_VERSIONS)
def test_the_schema_itself_is_sound(version: int) -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(schema_text(version)))


@pytest.mark.parametrize("place", [name for name, _ in DOCUMENTS])
def test_every_document_of_a_bundle_keeps_to_its_schema(made: Made, place: str) -> None:
    part = SCHEMA["x-files"][place] | {"$defs": SCHEMA["$defs"]}
    validator = jsonschema.Draft202012Validator(part)
    names = [name for name in made.files if name == place or (place.startswith("proofs/state") and "state-" in name)]
    assert names
    for name in names:
        validator.validate(json.loads(made.files[name]))


@pytest.mark.parametrize(
    ("version", "digest"),
    [
        (1, "c544144f2ad3df4c81d89e4ba773f0410a533d1ce2219e59c87c23ef811a8cc8"),
        (2, "1de270b416f2c35e6323d04f22d6fd3d2b4fe0c1d8a828da8d9341dc9ea947bf"),
    ],
)
def test_what_a_bundle_says_to_people_is_fixed_within_a_version(version: int, digest: str) -> None:
    """Else a bundle written by one release would be refused by the next. A change here is another version of the format."""
    assert sha256(README_TEXT.encode() + player_page([], [], {}) + schema_text(version)).hexdigest() == digest
