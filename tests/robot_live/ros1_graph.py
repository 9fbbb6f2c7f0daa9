"""A real ROS 1 graph on this machine for tests: Debian's rosmaster, and drivers in processes of their own.

Everything binds to the loopback address, keeps its files in a folder of the test, and ends with it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
from asyncio.subprocess import Process
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clients.robot.bag import make_bag
from clients.robot.events import Depth, Frame
from clients.robot.scenario import parse_scenario
from clients.robot.sources.rosbag import BagSource
from clients.robot.synthetic.render import Renderer

DEBIAN_PYTHON = "/usr/bin/python3"
PUBLISHER = Path(__file__).with_name("ros1_publisher.py")
START_TIMEOUT_S = 20.0
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


@dataclass
class Ros1Graph:
    """One master and whatever drivers a test starts. `folder` is for their files."""

    folder: Path
    port: int
    master: Process | None = None
    drivers: list[Process] = field(default_factory=list)

    @property
    def uri(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def environment(self) -> dict[str, str]:
        """What every process of the graph is given."""
        kept = {name: value for name, value in os.environ.items() if not name.startswith("ROS")}
        return {
            **kept,
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(self.folder / "ros-home"),
            "PYTHONWARNINGS": "",
        }

    async def start_master(self) -> None:
        self.master = await asyncio.create_subprocess_exec(
            *(DEBIAN_PYTHON, "/usr/bin/rosmaster", "--core", "-p", str(self.port)),
            env=self.environment,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
        )
        async with asyncio.timeout(START_TIMEOUT_S):
            while True:
                with contextlib.suppress(OSError):
                    _, writer = await asyncio.open_connection("127.0.0.1", self.port)
                    writer.close()
                    return
                await asyncio.sleep(0.05)

    async def kill_master(self) -> None:
        assert self.master is not None
        self.master.kill()
        await self.master.wait()

    async def start_drivers(self, scene: Path, **settings: Any) -> Process:
        """Start drivers that publish a scene; settings are those of `ros1_publisher`."""
        process = await asyncio.create_subprocess_exec(
            *(DEBIAN_PYTHON, str(PUBLISHER), json.dumps({"scene": str(scene), **settings})),
            env=self.environment,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        self.drivers.append(process)
        return process

    async def publish(self, scene: Path, **settings: Any) -> dict[str, int]:
        """Publish a scene to its end; return how many of each were published."""
        return await self.counts(await self.start_drivers(scene, **settings))

    async def counts(self, process: Process) -> dict[str, int]:
        """Return what drivers say at their end."""
        output, said = await asyncio.wait_for(process.communicate(), END_TIMEOUT_S)
        assert process.returncode == 0, said.decode()[-2_000:]
        counts: dict[str, int] = json.loads(output.splitlines()[-1])
        return counts

    async def stop(self) -> None:
        for process in [*self.drivers, *([self.master] if self.master else [])]:
            if process.returncode is None:
                process.kill()
                await process.wait()


@contextlib.asynccontextmanager
async def ros1_graph(folder: Path) -> AsyncIterator[Ros1Graph]:
    """A running master, which nothing knows yet."""
    await asyncio.to_thread(folder.mkdir, parents=True, exist_ok=True)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    graph = Ros1Graph(folder, port)
    try:
        await graph.start_master()
        yield graph
    finally:
        await graph.stop()


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
