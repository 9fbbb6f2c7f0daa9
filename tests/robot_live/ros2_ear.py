"""The robot's ROS 2 feed in a process of its own, in which ROS 2 was sourced: says what it is told, when it is asked.

One argument, a JSON object: `wanted`, topic to type, and `topics`, the text of a topics file. A line on standard input is a
question, `topics`, `state` or `close`; the answer is one JSON object on a line.
"""

import json
import signal
import sys
import threading
import time
from collections import Counter
from pathlib import Path

from clients.robot.sensing.sensor_events import Frame, RefusedMessage
from clients.robot.sources.live.ros2 import Ros2Feed
from clients.robot.sources.messages.decoding import MessageReader
from clients.robot.sources.messages.message_types import LearntTypes, types_with
from clients.robot.sources.messages.topics import parse_topics
from consensus.errors import BlockRobotError


class Ear:
    """A listener that reads each message as the robot does, and counts."""

    def __init__(self, topics):
        self.reader = MessageReader(topics)
        self.wanted = topics.wanted
        self.types = LearntTypes(types_with(topics.definitions), ros1=False)
        self.lock = threading.Lock()
        self.heard, self.events, self.lost, self.latest = Counter(), Counter(), Counter(), {}
        self.learnt, self.failures, self.unusable_topics, self.there = [], [], [], []

    def learn(self, type_name, definition):
        self.learnt.append([type_name, self.types.learn(type_name, definition)])

    def deliver(self, message, definition=""):
        assert definition == ""
        with self.lock:
            self.heard[f"{message.topic} {message.type}"] += 1
            if message.topic not in self.wanted:
                return
            for event in self.reader.read(message, self.types.of(message.type)):
                name = f"{event.kind}: {event.reason}" if isinstance(event, RefusedMessage) else type(event).__name__
                self.events[name] += 1
                if isinstance(event, Frame):
                    self.latest["shape"] = list(event.depth.shape)
                    self.latest["late_ms"] = event.received_at_ms - event.captured_at_ms

    def sight(self, sighting):
        raise AssertionError

    def refuse(self, refused):
        raise AssertionError

    def presence(self, part, *, here):
        assert here
        self.there.append(part)

    def miss(self, topic, count):
        self.lost[topic] += count

    def unusable(self, topic, error, *, for_good):
        self.unusable_topics.append([topic, error.code, error.detail, for_good])

    def fail(self, error):
        self.failures.append([error.code, error.detail])

    def state(self):
        with self.lock:
            return {
                "heard": self.heard,
                "events": self.events,
                "lost": self.lost,
                "learnt": self.learnt,
                "failures": self.failures,
                "unusable": self.unusable_topics,
                "there": self.there,
                **self.latest,
            }


def say(answer):
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def main():
    settings = json.loads(sys.argv[1])
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    feed, ear = Ros2Feed(settings.get("domain")), Ear(parse_topics(settings["topics"]))
    try:
        if settings.get("look_first"):
            say({"topics": feed.topics()})
        feed.open(settings["wanted"], ear)
    except BlockRobotError as error:
        say({"refused": error.code, "detail": error.detail, "threads": threading.active_count()})
        return
    say({"opened": True})
    for line in sys.stdin:
        question = line.strip()
        if question == "topics":
            say(feed.topics())
        elif question == "state":
            say(ear.state())
        elif question == "close":
            break
    began = time.monotonic()
    feed.close()
    feed.close()
    say(
        {
            **ear.state(),
            "closed_in_s": time.monotonic() - began,
            "threads": threading.active_count(),
            "handlers_kept": handlers == [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)],
            "logs": sorted(path.name for path in Path.home().iterdir()),
        }
    )


if __name__ == "__main__":
    main()
