"""The whole attack, small: one object, both figures of each pair, and an exit code that does not pass on a maybe."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import pytest
from click.testing import CliRunner

from network.cli.main import main
from network.lab.privacy.attack_run import MUST_WIN, too_weak
from network.lab.privacy.attacks import attacks_on_all
from network.lab.privacy.attacks.attacks_on_all import attack_all_schemes
from network.lab.privacy.attacks.trials import Features, Pairs, Trial, pairs_of
from network.lab.privacy.hospital.schemes import SCHEMES
from network.lab.privacy.scoring import Rate
from tests.unit.network.attack.conftest import SmallHospital

WON, LOST = Rate(1.0, 0.5, 1.0, 1.0, 100), Rate(0.5, 0.5, 0.49, 0.51, 100)


def test_an_attack_that_wins_nowhere_shows_nothing() -> None:
    rates = {name: {"prototype": WON, "ours": LOST} for name in MUST_WIN}
    assert too_weak(rates) == []
    assert too_weak(rates | {"link_key": {"prototype": LOST, "ours": LOST}}) == ["link_key"]
    del rates["dictionary"]
    assert too_weak(rates) == ["dictionary"]


def test_an_attacker_who_was_blinded_is_told_to_be_too_weak(
    hospital: SmallHospital, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same linker attacks both: on the prototype it must win by the mark, so ours is not safe from a blind one."""

    def blinded(trials: Sequence[Trial], _: Features) -> Pairs:
        return pairs_of(trials, lambda first, second: [0.0])

    with ThreadPoolExecutor(1) as pool:
        seeing, _ = attack_all_schemes(hospital.evidence, pool, lambda _: None)()
        assert {"link_key", "link_all"}.isdisjoint(too_weak(seeing))
        monkeypatch.setattr(attacks_on_all, "pairs_of", blinded)
        blind, _ = attack_all_schemes(hospital.evidence, pool, lambda _: None)()
    assert {"link_key", "link_all"} <= set(too_weak(blind))


@pytest.mark.timeout(200)
def test_a_small_run_from_the_command_line() -> None:
    # Keys are drawn anew each time. Over two days noise wins all pairs there are about once in eighty runs.
    arguments = ["privacy", "attack", "--people", "12", "--days", "3", "--uid-bits", "12", "--seed", "4", "--json"]
    ran = CliRunner().invoke(main, arguments)
    result = json.loads(ran.stdout)
    assert set(result) == {"name", "ok", "figures", "conditions"}
    figures, conditions = result["figures"], result["conditions"]
    assert conditions["people"] == 12
    assert conditions["records"] > 50
    for name in MUST_WIN:
        assert figures[f"{name}_prototype_success_rate"] >= 0.95
        for scheme in SCHEMES:
            assert f"{name}_{scheme}_guess_rate" in figures
    assert figures["attacks_too_weak"] == []
    assert figures["dictionary_salted_success_rate"] == 1.0
    # The attacker learns from marks that are drawn anew each time: it may err once in a while.
    assert figures["link_key_peppered_success_rate"] >= 0.9
    for name in ("dictionary", "name", "custodian_opens", "backup_with_keys_opens", "robot_names_past", "grant_names"):
        assert figures[f"{name}_ours_success_rate"] == 0.0
    # So few people show nothing: the bounds are too wide, and the run says so.
    assert not result["ok"]
    assert len(figures["leaks_on_ours"]) > len(MUST_WIN)
    assert ran.exit_code == 1
