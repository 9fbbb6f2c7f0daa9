"""Ground truth of the synthetic scene, for judging renditions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from clients.robot.pairing.tag_pairing import WINDOW_DEFAULT_MS
from clients.robot.synthetic.camera import Labels
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Scenario
from clients.robot.synthetic.scenario_bag import Scene, scenario_of
from clients.sdk.pictures.picture_names import read_robot_frame
from clients.sdk.pictures.rendition_picture import decode_depth_png

FOREIGN_PIXELS_MAX_SHARE = 0.001
JUDGED_FRAMES_MAX_COUNT = 40


def covered_frames(scenario: Scenario, alias: str) -> set[int]:
    person = next(person for person in scenario.people if person.alias == alias)
    times = [round(1000 * reading) for reading in person.reading_times_s()] if person.tagged else []
    return {
        index
        for index in range(scenario.frame_count)
        if any(abs(round(1000 * index / scenario.frame_rate) - at) <= WINDOW_DEFAULT_MS for at in times)
    }


def labels_of(scene: Scene) -> Callable[[int], Labels]:
    """Return what gives, for every pixel of a frame, the number of the person whom it shows (0: nobody)."""
    if isinstance(scene, Drive):
        drive = DriveRenderer(scene)
        return lambda sequence: drive.truth(sequence).labels
    standing = Renderer(scene)
    return lambda sequence: standing.frame_with_truth(sequence)[1]


def foreign_share(scenario: Scenario, labels: Labels, picture: Path, owner: str) -> float:
    """Another person's true pixels in an owner's `.depth.png`."""
    shown = decode_depth_png(picture.read_bytes())
    aliases = [person.alias for person in scenario.people]
    others = np.isin(labels, [index + 1 for index, alias in enumerate(aliases) if alias != owner])
    total = int(others.sum())
    return float((others & (shown > 0)).sum() / total) if total else 0.0


def worst_foreign_share(scene: Scene, pictures: list[Path], owner: str) -> tuple[float, int]:
    """Return the largest share of anybody else's pixels in a picture, and in how many others were in view."""
    truth = labels_of(scene)
    step = max(1, len(pictures) // JUDGED_FRAMES_MAX_COUNT)
    shares, with_others = [0.0], 0
    for picture in sorted(pictures)[::step]:
        labels = truth(read_robot_frame(picture.name))
        with_others += len(set(np.unique(labels).tolist()) - {0}) > 1
        shares.append(foreign_share(scenario_of(scene), labels, picture, owner))
    return max(shares), with_others
