"""GDPR Articles 15 and 20: a person gets a copy of her data, with what she has to be told, and can take it elsewhere.

15(1): (a) purposes, (b) what kinds of data, (c) who received them, (d) how long they are kept, (e) her rights as she used
them, (g) where they come from; 15(3): a copy; 15(4): nothing of others; 20(1): structured, commonly used and
machine-readable; 20(2): usable by another controller, without hindrance from the one that has them.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from clients.bundle.checking import verify_bundle
from tests.unit.clients.bundle.conftest import make
from tests.unit.clients.bundle.ward import Ward


@pytest.fixture
async def ward(tmp_path: Path) -> Ward:
    """Somebody who was recorded twice, looked, had one record erased; and a stranger in the same ward."""
    ward = Ward(tmp_path)
    visit = ward.open_visit()
    ward.record(visit)
    erased = ward.record(visit)
    ward.close_visit(visit)
    await ward.erase(visit, [erased])
    stranger = ward.chain.enrol("stranger")
    ward.chain.record(ward.chain.open_visit(stranger))
    await make(ward, tmp_path / "mine.zip")
    return ward


@pytest.fixture
def bundle(ward: Ward, tmp_path: Path) -> zipfile.ZipFile:
    return zipfile.ZipFile(tmp_path / "mine.zip")


def told(bundle: zipfile.ZipFile, name: str) -> Any:
    return json.loads(bundle.read(f"data/{name}.json"))


def test_15_1_a_b_d_g_purposes_kinds_periods_and_sources(bundle: zipfile.ZipFile, ward: Ward) -> None:
    (visit,) = told(bundle, "visits")["visits"]
    record = visit["records"][0]
    assert visit["purpose"] == "care"
    assert (record["sensor"], record["frame_count"]) == ("depth", 2)
    assert record["expires_at_ms"] > record["started_at_ms"] > 0
    assert record["robot"] == ward.chain.robot.identity.public_key.hex()


def test_15_1_c_who_received_what_and_why(bundle: zipfile.ZipFile) -> None:
    (access,) = told(bundle, "access")["accesses"]
    assert access["purpose"] == "own-access"
    assert "access_requested" in {entry["kind"] for entry in told(bundle, "audit")["entries"]}


def test_15_1_e_her_rights_as_she_used_them(bundle: zipfile.ZipFile) -> None:
    (erasure,) = told(bundle, "erasures")["erasures"]
    assert (erasure["status"], len(erasure["receipts"])) == ("complete", 2)
    assert {choice["purpose"] for choice in told(bundle, "consents")["choices"]} == {"care", "demo"}
    assert len(told(bundle, "rights")["visits"]) == 1


def test_15_3_a_copy_of_the_pictures(bundle: zipfile.ZipFile) -> None:
    pictures = [name for name in bundle.namelist() if name.startswith("pictures/")]
    assert len(pictures) == 2
    assert all(bundle.read(name).startswith(b"\x89PNG") for name in pictures)


def test_15_4_nothing_of_others(bundle: zipfile.ZipFile, ward: Ward) -> None:
    """Trie proofs hold hashes of neighbours, never their keys or values."""
    visit, _ = ward.chain.visit_of(ward.chain.enrol("somebody-else"))
    others = [visit.owner, ward.chain.value("records", b"announcement/" + bytes(7) + b"\x01")[0]]
    content = b"".join(bundle.read(name) for name in bundle.namelist())
    for owner in others:
        assert owner.hex().encode() not in content
        assert owner not in content


def test_20_1_structured_commonly_used_and_machine_readable(bundle: zipfile.ZipFile) -> None:
    schema = json.loads(bundle.read("schema.json"))
    for name, part in schema["x-files"].items():
        if name.startswith("data/"):
            jsonschema.Draft202012Validator(part | {"$defs": schema["$defs"]}).validate(json.loads(bundle.read(name)))


def test_20_2_another_controller_can_rely_on_it_without_asking_the_first(ward: Ward, tmp_path: Path) -> None:
    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis.block_id)
    assert verdict.is_anchored
    assert verdict.manifest.problems == []
