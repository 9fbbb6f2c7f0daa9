"""Frames, labels and readings of the scenes that there are: whatever the camera learns, they stay as they were."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from importlib import resources

import pytest

from clients.robot.synthetic.render import Renderer, readings
from clients.robot.synthetic.scenario import Scenario, parse_scenario
from clients.robot.synthetic.scenes import STRATA, Stratum, draw_scene

DRAWN: dict[str, str] = {
    "apart": "c9bedcd90270ec34",
    "close": "27a6715b76fddff0",
    "touching": "4f4d3f0d14d26529",
    "crossing": "6aa0f8664e084ba5",
    "companion": "f7787766c6ba9731",
    "bearer-behind": "bdb862a54a81fbae",
    "moving-robot": "29ef88ede10298fd",
    "single": "2f959e022b44ce8f",
    "wheelchair": "836dcc7eb4ab9267",
    "rollator": "7cd0bb788abace86",
    "stick": "1b7e438afcc47131",
    "iv-pole": "dd3eae57465715cf",
    "child": "0c05aa4b4aff7ecf",
    "bed": "73f9ebb1184b32ee",
}
PACKAGED: dict[str, str] = {
    "experiment-1": "9cb815d9a19a9414",
    "experiment-3": "e6ed6f2c43764b6c",
    "experiment-4": "31447ec4f3a20e10",
    "published-run-1": "ab5fff7d9c9a2600",
}


def digest_of(scene: Scenario, indices: tuple[int, ...]) -> str:
    """Return the digest of some frames at a quarter of the width, with their truth, and of all readings."""
    renderer = Renderer(replace(scene, width=160, height=120, focal_px=131.25))
    digest = hashlib.sha256(renderer.empty_frame(2).tobytes())
    for index in indices:
        truth = renderer.truth(index)
        digest.update(truth.depth.tobytes() + truth.labels.tobytes() + truth.props.tobytes())
    for reading in readings(scene):
        digest.update(f"{reading.alias} {reading.arrives_s} {reading.distance_m:.9f} {reading.facing}".encode())
    return digest.hexdigest()[:16]


@pytest.mark.parametrize("stratum", STRATA)
def test_a_drawn_scene_has_the_frames_that_it_had(stratum: Stratum) -> None:
    assert digest_of(draw_scene(5, stratum), (3, 40, 110)) == DRAWN[stratum]


@pytest.mark.parametrize("name", PACKAGED)
def test_a_packaged_scene_has_the_frames_that_it_had(name: str) -> None:
    text = (resources.files("clients.robot") / "scenarios" / f"{name}.toml").read_text(encoding="utf-8")
    scene = parse_scenario(text)
    assert digest_of(scene, tuple(scene.frame_count * part // 8 for part in range(1, 8))) == PACKAGED[name]
