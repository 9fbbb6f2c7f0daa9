"""The cost model's prices are those of real work: `sim calibrate` measures each of them."""

from __future__ import annotations

import json

from click.testing import CliRunner

from network.cli.measure.sim_commands import calibrate_command
from network.sim.world.cpu import COSTS

FARTHEST = 8.0
"""How many times dearer or cheaper than the table a machine may be on which the model still says something."""


def test_every_price_is_near_what_the_work_takes_here() -> None:
    result = CliRunner().invoke(calibrate_command, ["--json"])
    assert result.exit_code == 0
    figures = json.loads(result.stdout)["figures"]
    assert figures.keys() == COSTS._asdict().keys()
    far = {
        name: figure
        for name, figure in figures.items()
        if not 1 / FARTHEST < figure["measured_us"] / figure["charged_us"] < FARTHEST
    }
    assert far == {}
