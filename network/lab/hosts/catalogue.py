"""The stories of several hosts, by name."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple

from msgspec import Struct

from consensus.errors import BlockRobotError
from network.bench.conditions import Condition, measure_conditions
from network.lab.hosts.founded_network import ORGANISATIONS, FoundedNetwork
from network.lab.hosts.loss_stories import cut_off, lose_for_good
from network.lab.hosts.node_stories import (
    catch_a_liar,
    differ_clocks,
    plain_network,
    renew_all_day,
    upgrade_one_by_one,
)
from network.lab.hosts.outcomes import Tell
from network.lab.hosts.patient_story import record_from_elsewhere
from network.lab.hosts.proxy_stories import bear_slow_strangers, proxied_network, tell_clients_apart


class Story(NamedTuple):
    """What is told, on which network, and how it is played; what that returns has `failures()`."""

    summary: str
    network: Callable[[Path, Tell], AbstractContextManager[FoundedNetwork]]
    play: Callable[[FoundedNetwork, Tell], Any]


STORIES = {
    "patient": Story("A robot and a wallet work from a host without a node.", plain_network, record_from_elsewhere),
    "cut": Story("A host is cut off and comes back.", plain_network, cut_off),
    "lost": Story("A host is lost for good and made anew.", plain_network, lose_for_good),
    "clocks": Story("Clocks are up to three seconds apart.", plain_network, differ_clocks),
    "renewals": Story("Certificates are renewed all day, compressed.", plain_network, renew_all_day),
    "upgrade": Story("One node after another gets a later program.", plain_network, upgrade_one_by_one),
    "liar": Story("An organisation's node signs two blocks for one round.", plain_network, catch_a_liar),
    "callers": Story("Callers behind one proxy, one of whom asks too much.", proxied_network, tell_clients_apart),
    "slow": Story("A stranger keeps connections half open everywhere.", proxied_network, bear_slow_strangers),
}


class StoryResult(Struct, kw_only=True):
    """A story that was played; `ok` without failures."""

    name: str
    ok: bool
    failures: list[str]
    figures: Any
    conditions: dict[str, Condition]


def play_story(name: str, tell: Tell) -> StoryResult:
    """On hosts that are made for it and removed. Raises HOSTS_UNAVAILABLE, HOSTS_STORY_FAILED, PROGRAM_MISSING."""
    if os.geteuid() != 0:
        raise BlockRobotError("HOSTS_UNAVAILABLE", "You are not root.")
    story, conditions = STORIES[name], measure_conditions(nodes=len(ORGANISATIONS))
    with tempfile.TemporaryDirectory(prefix="blockrobot-hosts-") as place, story.network(Path(place), tell) as network:
        outcome = story.play(network, tell)
    failures = outcome.failures()
    return StoryResult(name=name, ok=not failures, failures=failures, figures=outcome, conditions=conditions)
