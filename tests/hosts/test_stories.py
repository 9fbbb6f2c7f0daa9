"""Four organisations on hosts of their own while clients work: a patient elsewhere, hosts away, wrong clocks, renewals, an
upgrade, a liar. One network for all: the liar comes last."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from network.lab.hosts.founded_network import ORGANISATIONS, FoundedNetwork, node_of
from network.lab.hosts.loss_stories import cut_off, lose_for_good
from network.lab.hosts.node_stories import (
    RENEWALS_COUNT,
    Outcome,
    catch_a_liar,
    differ_clocks,
    plain_network,
    renew_all_day,
    upgrade_one_by_one,
)
from network.lab.hosts.patient_story import record_from_elsewhere

STORY_MAX_S = 600
NODES = {node_of(name) for name in ORGANISATIONS}
pytestmark = pytest.mark.timeout(STORY_MAX_S)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FoundedNetwork]:
    with plain_network(tmp_path_factory.mktemp("hosts"), print) as network:
        yield network


def _require_work(outcome: Outcome) -> None:
    assert outcome.failures() == []
    assert all(seen.finals > 0 and seen.connections > 0 for seen in outcome.seen)
    assert set(outcome.kept.missing) == NODES


def test_a_robot_and_a_wallet_on_a_host_without_a_node_need_only_the_others(network: FoundedNetwork) -> None:
    patient = record_from_elsewhere(network, print)
    assert patient.failures() == []
    assert patient.records > 0


def test_a_host_that_is_cut_off_misses_nothing_once_it_is_back(network: FoundedNetwork) -> None:
    absence = cut_off(network, print)
    _require_work(absence)
    assert absence.node == "lab-1"


def test_a_host_that_is_lost_for_good_is_made_anew_from_a_backup_and_nothing_is_missing(
    network: FoundedNetwork,
) -> None:
    _require_work(lose_for_good(network, print))


def test_clocks_three_seconds_apart_stop_nobody(network: FoundedNetwork) -> None:
    clocks = differ_clocks(network, print)
    _require_work(clocks)
    assert sorted(clocks.offsets_ms.values()) == [0, 1_000, 2_000, 3_000]


def test_a_day_of_renewals_refuses_no_connection(network: FoundedNetwork) -> None:
    renewals = renew_all_day(network, print)
    _require_work(renewals)
    assert 0 < renewals.expired < renewals.renewals == RENEWALS_COUNT


def test_an_upgrade_of_one_node_after_another_loses_nothing(network: FoundedNetwork) -> None:
    upgrade = upgrade_one_by_one(network, print)
    _require_work(upgrade)
    assert set(upgrade.versions) == NODES
    assert all(seen.connections_refused for seen in upgrade.seen), "a node that is stopped takes no connection"


def test_an_organisation_that_lies_is_found_out_and_the_others_go_on(network: FoundedNetwork) -> None:
    liar = catch_a_liar(network, print)
    _require_work(liar)
    assert (liar.liar, liar.status) == ("lab-1", "suspended")
    assert liar.evidence in {"proposal", "vote"}
