"""A recording as a hospital's own robot would make it: metres, JSON from the reader, one person who stands still."""

from __future__ import annotations

import json
from pathlib import Path

from clients.robot.sensing.sensor_events import Frame, Sighting
from clients.robot.sources.live.synthetic_source import SyntheticSource
from clients.robot.synthetic.scenario import load_scenario
from tests.unit.clients.robot.sources.recordings import START_MS, Topic, image, record

UID = "E28011606000020A1B2C3D4E"
SCENARIO = """
name = "own"
duration_s = 12.0
frame_rate = 10
width = 320
height = 240
focal_px = 262.5
camera_height_m = 1.2
seed = 7
empty_frames = 30

[reader]
distance_sigma_m = 0.15
antenna_front = 1
antenna_back = 2
front_misread = 0.0

[[people]]
alias = "somebody"
height_m = 1.70
girth = 1.0
cadence = 1.0
path = [[4.0, -0.4, 2.6], [12.0, -0.4, 2.6]]
readings_s = [4.0, 11.9]
also_every_s = 0.5
"""


def write_own_recording(folder: Path) -> Path:
    """Write `my-recording` (a rosbag2 folder) below `folder`: three seconds without anybody, then one person."""
    scenario_file = folder / "own-scenario.toml"
    scenario_file.write_text(SCENARIO, encoding="utf-8")
    source = SyntheticSource(load_scenario(scenario_file), {"somebody": UID}, frames_per_s=10)
    frames, readings = [], []
    start_ms = source.start_ms
    for event in source.events():
        if isinstance(event, Frame):
            at_ms = event.captured_at_ms - start_ms
            pixels = (event.depth / 1000).astype("float32")
            frames.append((at_ms, image(pixels, "32FC1", START_MS + at_ms)))
        elif isinstance(event, Sighting):
            text = json.dumps({"tag": {"uid": event.uid}, "range": event.distance_m})
            readings.append((event.first_seen_ms - start_ms, {"data": text}))
    found = [Topic("/front/depth", "sensor_msgs/msg/Image", frames), Topic("/reader", "std_msgs/msg/String", readings)]
    scenario_file.unlink()
    return record(folder / "my-recording", "mcap", found, {})
