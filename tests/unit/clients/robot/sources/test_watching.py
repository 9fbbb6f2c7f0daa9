"""What a robot says of topics that vanish and return, of a camera that falls silent, and of a master that is gone."""

from __future__ import annotations

from clients.robot.sources.live.live_source import SILENT_AFTER_S, Watch
from clients.robot.sources.live.ros1 import Ros1Feed

BOTH = {"/depth": "a/msg/B", "/tags": "a/msg/C"}


def test_a_topic_that_vanishes_is_counted_each_time_and_one_that_is_waited_for_is_not_gone() -> None:
    watch = Watch("ros1", BOTH, "/depth")
    assert watch.look({**BOTH, "/other": "x"}) == []
    assert watch.look(BOTH) == []
    assert watch.gone == {}
    watch = Watch("ros1", BOTH, "/depth")
    assert watch.look({"/depth": "a/msg/B"}) == ["/tags is not advertised; it is waited for."]
    assert watch.look({"/depth": "a/msg/B"}) == []
    assert watch.look(BOTH) == ["/tags is there."]
    assert +watch.gone == {}
    watch = Watch("ros1", ["/depth"], "/depth")
    for _ in range(3):
        watch.look(BOTH)
        assert watch.look({}) == ["/depth is not advertised; it is waited for."]
    assert watch.gone == {"/depth": 3}


def test_a_feed_that_does_not_answer_says_nothing_of_its_topics() -> None:
    name = Ros1Feed("http://10.0.0.1:11311").name
    watch = Watch(name, BOTH, "/depth")
    watch.look(BOTH)
    assert watch.look(None) == ["The ROS 1 master at http://10.0.0.1:11311 does not answer; what is connected goes on."]
    assert watch.look(None) == []
    assert watch.look(BOTH) == ["The ROS 1 master at http://10.0.0.1:11311 answers again."]
    assert +watch.gone == {}


def test_a_camera_that_falls_silent_is_said_once_and_again_when_it_is_heard() -> None:
    watch = Watch("ros1", BOTH, "/depth")
    assert watch.listen(10.0, 9.0) == []
    assert watch.listen(9.0 + SILENT_AFTER_S, 9.0) == ["/depth is silent: no frame for 5 s."]
    assert watch.listen(30.0, 9.0) == []
    assert watch.listen(31.0, 30.5) == ["/depth is heard again, after 22 s."]
    assert watch.listen(32.0, 31.5) == []
