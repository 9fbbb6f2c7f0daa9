"""Nodes behind nginx: callers are told apart by address and by session, nobody by a header of their own, and slow ones
delay nobody."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from network.lab.hosts.founded_network import ORGANISATIONS, FoundedNetwork, node_of
from network.lab.hosts.proxy_stories import bear_slow_strangers, proxied_network, tell_clients_apart
from network.lab.hosts.visits import FEW_COUNT

STORY_MAX_S = 420
pytestmark = [pytest.mark.timeout(STORY_MAX_S), pytest.mark.system_packages]


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FoundedNetwork]:
    with proxied_network(tmp_path_factory.mktemp("hosts"), print) as network:
        yield network


def test_callers_behind_one_proxy_are_told_apart_and_forged_headers_are_ignored(network: FoundedNetwork) -> None:
    told = tell_clients_apart(network, print)
    assert told.failures() == []
    for each in (told.proxied, told.direct):
        assert each.flood["429"] > 0
        assert each.neighbour == each.member == each.fellow == {"200": FEW_COUNT}


def test_half_handshakes_and_half_requests_delay_nobody_else(network: FoundedNetwork) -> None:
    slow = bear_slow_strangers(network, print)
    assert slow.failures() == []
    assert slow.strangers.opened > slow.strangers.held > 0, "some were closed for being slow"
    assert all(seen.finals > 0 and seen.connections > 0 for seen in slow.seen)
    assert slow.kept.missing == {node_of(name): 0 for name in ORGANISATIONS}
