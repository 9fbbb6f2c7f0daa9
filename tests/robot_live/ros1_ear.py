"""The robot's ROS 1 source in a process of its own, since a process can hold one ROS 1 node once. Says what it hears.

Its one argument is a JSON object: `uri` of the master, and `topics`, the text of a topics file. On standard output comes a
JSON object several times a second; standard input's end ends it.
"""

import asyncio
import json
import resource
import sys
import threading
from collections import Counter
from pathlib import Path

from clients.robot.sensing.sensor_clocks import RunClocks
from clients.robot.sensing.sensor_events import Frame, RefusedMessage, Sighting
from clients.robot.sources.live.live_source import LiveSource
from clients.robot.sources.live.ros1 import Ros1Feed
from clients.robot.sources.messages.topics import parse_topics
from clients.robot.sources.source import StoppableClock
from consensus.errors import BlockRobotError

SAY_EVERY_S = 0.2


class Ear:
    def __init__(self, settings):
        self.said, self.refused = [], Counter()
        self.frames, self.sightings, self.shape, self.middle_mm = 0, 0, None, 0
        self.uids, self.latest = set(), {}
        self.clocks = RunClocks()
        self.admitted = 0
        topics = parse_topics(settings["topics"])
        self.source = LiveSource([Ros1Feed(settings["uri"])], topics, self.said.append)

    def take(self, event):
        if isinstance(event, RefusedMessage):
            self.refused[f"{event.kind} {event.reason}"] += 1
            return
        self.admitted += len(self.clocks.admit(event))
        if isinstance(event, Frame):
            self.frames += 1
            self.shape = list(event.depth.shape)
            row = event.depth[event.depth.shape[0] // 2]
            measured = row[row > 0]  # the camera's noise has holes
            self.middle_mm = int(measured[len(measured) // 2])
        elif isinstance(event, Sighting):
            self.sightings += 1
            self.uids.add(event.uid)
            if not event.uid.startswith("STORM"):
                self.latest = {"uid": event.uid, "distance_m": event.distance_m, "antenna": event.antenna}

    def state(self):
        return {
            "frames": self.frames,
            "sightings": self.sightings,
            "uids": len(self.uids),
            "latest": self.latest,
            "shape": self.shape,
            "middle_mm": self.middle_mm,
            "refused": self.refused,
            "said": self.said,
            "admitted": self.admitted,
            "offsets_ms": {name: estimate.offset_ms for name, estimate in self.clocks.estimates().items()},
            "focal_px": self.source.focal_px,
            "intake": self.source.count_intake()._asdict(),
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
            "threads": threading.active_count(),
        }

    async def listen(self):
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        loop.add_reader(sys.stdin, stop.set)

        async def go_on_saying():
            while True:
                say(self.state())
                await asyncio.sleep(SAY_EVERY_S)

        saying = asyncio.create_task(go_on_saying())
        async for event in self.source.play(StoppableClock(stop)):
            self.take(event)
        saying.cancel()


def say(answer):
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def main():
    try:
        ear = Ear(json.loads(sys.argv[1]))
        with ear.source:
            asyncio.run(ear.listen())
    except BlockRobotError as error:
        say({"code": error.code, "detail": error.detail})
        return
    say({"closed": True, **ear.state()})


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    main()
