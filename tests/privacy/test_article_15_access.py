"""GDPR Article 15: a person gets a copy of her data, with what she has to be told.

15(1): (a) purposes, (b) what kinds of data, (c) who received them, (d) how long they are kept, (e) her rights as she used
them, (g) where they come from; 15(3): a copy; 15(4): nothing of others.
"""

from __future__ import annotations

import json
import zipfile
from typing import Any

from tests.world.ward import Ward


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
