"""`blockrobot` whose demonstration plays the published run while people are there, at ten frames a second."""

from __future__ import annotations

from dataclasses import replace

from clients.robot.synthetic.scenario import Scenario, published_run_1
from network.cli.main import main
from network.demo import story

FRAME_RATE = 10
EVERYBODY_LEFT_S = 19.0
"""The run goes on for half a minute in an empty corridor, and robots play in real time."""


def with_fewer_frames() -> Scenario:
    """Return the same people and tags in 190 frames of 1,500; recordings are kept by their scenario's digest."""
    scenario = published_run_1()
    digest = f"{scenario.digest} at {FRAME_RATE} frames a second until {EVERYBODY_LEFT_S} s"
    return replace(scenario, frame_rate=FRAME_RATE, duration_s=EVERYBODY_LEFT_S, digest=digest)


if __name__ == "__main__":
    story.published_run_1 = with_fewer_frames
    main()
