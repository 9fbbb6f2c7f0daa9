"""A small hospital, played once for all tests of the attack, and its custodian."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from network.lab.privacy.attacks.evidence import Evidence, gather
from network.lab.privacy.hospital import attacked_days
from network.lab.privacy.hospital.attacked_custodian import CustodyStory, keep_last_day
from network.lab.privacy.hospital.attacked_days import Played, play
from network.lab.privacy.hospital.population import draw_population

SEED = 3
SERIAL_BITS = 10


@dataclass(frozen=True)
class SmallHospital:
    """Ten people on three days (on two, pure noise may win all pairs there are), and what was left behind."""

    played: Played
    evidence: Evidence
    custody: CustodyStory
    folder: Path


@pytest.fixture(scope="session")
def hospital(tmp_path_factory: pytest.TempPathFactory) -> SmallHospital:
    folder = tmp_path_factory.mktemp("attacked")
    population = draw_population(SEED, people=10, days=3, serial_bits=SERIAL_BITS)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            attacked_days, "WALLETS_A_DAY_SHARE", 1.0
        )  # of so few, else hardly two would ask on one evening
        played = play(population, folder, seed=SEED)
    evidence = gather(played, seed=SEED, boosting=False)
    return SmallHospital(played, evidence, keep_last_day(played, folder / "custodian"), folder)
