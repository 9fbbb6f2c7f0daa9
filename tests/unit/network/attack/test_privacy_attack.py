"""The whole attack, small: one object, both figures of each pair, and an exit code that does not pass on a maybe."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from network.attack.run import MUST_WIN, too_weak
from network.attack.schemes import SCHEMES
from network.attack.scoring import Rate
from network.cli.main import main

WON, LOST = Rate(1.0, 0.5, 1.0, 1.0, 100), Rate(0.5, 0.5, 0.49, 0.51, 100)


def test_an_attack_that_wins_nowhere_shows_nothing() -> None:
    rates = {name: {"prototype": WON, "ours": LOST} for name in MUST_WIN}
    assert too_weak(rates) == []
    assert too_weak(rates | {"link_key": {"prototype": LOST, "ours": LOST}}) == ["link_key"]
    del rates["dictionary"]
    assert too_weak(rates) == ["dictionary"]


@pytest.mark.timeout(200)
def test_a_small_run_from_the_command_line() -> None:
    arguments = ["privacy", "attack", "--people", "12", "--days", "2", "--uid-bits", "12", "--seed", "4", "--json"]
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
    assert figures["link_key_peppered_success_rate"] == 1.0
    for name in ("dictionary", "name", "custodian_opens", "backup_with_keys_opens", "robot_names_past"):
        assert figures[f"{name}_ours_success_rate"] == 0.0
    # So few people show nothing: the bounds are too wide, and the run says so.
    assert not result["ok"]
    assert "link_key" in figures["leaks_on_ours"]
    assert ran.exit_code == 1
