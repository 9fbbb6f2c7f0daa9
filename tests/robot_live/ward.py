"""What live tests over any middleware share: what the camera sees, where it stands in messages, and how drivers end.

Everything binds to the loopback address.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from asyncio.subprocess import Process
from pathlib import Path

from clients.robot.sensing.sensor_events import Depth, Frame
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import parse_scenario
from clients.robot.synthetic.scenario_bag import make_bag
from tests.cluster.network_under_test import find_base_port

START_TIMEOUT_S = 60.0
END_TIMEOUT_S = 60.0
TOPICS_FILE = """
[depth]
topic = "/kinect/depth/image"

[[tags]]
topic = "/rfid"
epc = "tags[].epc"
antenna = "tags[].antenna"
front = [1]
back = [2]
rssi = "tags[].rssi_dbm"
distance = "tags[].range_mm"
distance_sigma = 100
distance_unit = "mm"
first_seen = "tags[].seen"
"""


def free_port() -> int:
    """A port of the loopback address that nobody uses, and that the system gives to no connection by itself meanwhile."""
    return find_base_port(1)


async def wait_for_port(port: int) -> None:
    """Return when somebody listens."""
    async with asyncio.timeout(START_TIMEOUT_S):
        while True:
            with contextlib.suppress(OSError):
                _, writer = await asyncio.open_connection("127.0.0.1", port)
                writer.close()
                return
            await asyncio.sleep(0.05)


async def published_counts(process: Process) -> dict[str, int]:
    """Wait for drivers to end; return how many of each they say that they have published."""
    output, said = await asyncio.wait_for(process.communicate(), END_TIMEOUT_S)
    assert process.returncode == 0, said.decode()[-2_000:]
    counts: dict[str, int] = json.loads(output.splitlines()[-1])
    return counts


async def kill_all(processes: list[Process]) -> None:
    """Kill those that still run."""
    for process in processes:
        if process.returncode is None:
            process.kill()
            await process.communicate()


def make_scene(text: str, uid: str, folder: Path, *, empty: bool = False) -> Path:
    """Render a scenario, people or `empty`, into a file that drivers read; return the file that describes it."""
    folder.mkdir(parents=True, exist_ok=True)
    scenario = parse_scenario(text)
    if empty:
        renderer = Renderer(scenario)
        frames: list[Depth] = [renderer.empty_frame(number) for number in range(1, scenario.empty_frames + 1)]
        readings = [{"antenna": 1, "distance_m": 2.0}] * len(frames)
    else:
        source = BagSource(make_bag(scenario, {"ann": uid}, folder / "bags", workers=1))
        events = list(source.events())
        pictures = [event for event in events if isinstance(event, Frame)]
        frames = [event.depth for event in pictures]
        seen = [event for event in events if not isinstance(event, Frame)]
        readings = []
        for picture in pictures:
            near = min(seen, key=lambda event: abs(event.middle_ms - picture.captured_at_ms))
            readings.append({"antenna": near.antenna, "distance_m": near.distance_m})
    name = "empty" if empty else "scene"
    (folder / f"{name}.raw").write_bytes(b"".join(frame.tobytes() for frame in frames))
    height, width = frames[0].shape
    described = {
        "frames": str(folder / f"{name}.raw"),
        "count": len(frames),
        "width": width,
        "height": height,
        "focal_px": scenario.focal_px,
        "uid": uid,
        "readings": readings,
    }
    path = folder / f"{name}.json"
    path.write_text(json.dumps(described), encoding="utf-8")
    return path
