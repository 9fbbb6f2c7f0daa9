"""GDPR Article 20: a person takes her data elsewhere.

20(1): structured, commonly used and machine-readable; 20(2): usable by another controller, without hindrance from the one
that has them.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import jsonschema

from clients.bundle.checks.bundle_check import verify_bundle
from tests.world.ward import Ward


def test_20_1_structured_commonly_used_and_machine_readable(bundle: zipfile.ZipFile) -> None:
    schema = json.loads(bundle.read("schema.json"))
    for name, part in schema["x-files"].items():
        if name.startswith("data/"):
            jsonschema.Draft202012Validator(part | {"$defs": schema["$defs"]}).validate(json.loads(bundle.read(name)))


def test_20_2_another_controller_can_rely_on_it_without_asking_the_first(ward: Ward, tmp_path: Path) -> None:
    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis.block_id)
    assert verdict.is_anchored
    assert verdict.manifest.problems == []
