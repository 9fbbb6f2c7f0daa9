"""When a visit is closed stands on the chain: it must tell nothing of who said no, and would if it followed her word."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from clients.robot.recording.visit_keyring import CLOSE_DELAY_MAX_MS, VisitKeyring
from network.lab.privacy.attacks.ledger_view import LedgerView, read_ledger
from network.lab.privacy.attacks.open_limits import attack_consent_words
from network.lab.privacy.hospital.attacked_days import play
from network.lab.privacy.hospital.population import draw_population
from network.lab.privacy.scoring import Rate
from tests.unit.network.attack.conftest import SEED, SERIAL_BITS

NINE_MINUTES_MS, BESIDE_MS = 9 * 60_000, 20_000


def play_refusals(folder: Path) -> tuple[LedgerView, Rate]:
    """Play a day on which one in four says no amid her stay; return the ledger, and how often closings name her."""
    population = draw_population(SEED, people=40, days=1, serial_bits=SERIAL_BITS)
    stays = []
    for stay in population.stays:
        says_no = None
        if stay.person % 4 == 0 and len(stay.clips_at_ms) >= 4 and not stay.is_long:
            says_no = stay.clips_at_ms[len(stay.clips_at_ms) // 2] + 1
        stays.append(replace(stay, says_no_at_ms=says_no))
    played = play(replace(population, stays=tuple(stays)), folder, seed=SEED)
    view = read_ledger(played.chain.blocks)
    return view, attack_consent_words(played, view, by_closing_alone=True)


def close_with_the_word(book: VisitKeyring, owner: bytes, now_ms: int) -> bool:
    """Tell that a visit is over once nothing is recorded in it any more."""
    book._forget_ended(now_ms)
    return any(visit.chain.owner == owner for visit in book._open.values())


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> tuple[LedgerView, Rate]:
    return play_refusals(tmp_path_factory.mktemp("shipped"))


def test_a_visit_that_is_closed_because_she_said_no_names_her(
    shipped: tuple[LedgerView, Rate], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, rate = shipped
    monkeypatch.setattr(VisitKeyring, "goes_on", close_with_the_word)
    _, leaking = play_refusals(tmp_path)
    assert leaking.trials == rate.trials > 5
    assert leaking.success > 0.6 > 0.45 > rate.success


def test_robots_are_played_to_close_when_nine_minutes_and_a_delay_are_over(shipped: tuple[LedgerView, Rate]) -> None:
    lasted = [visit.closed_at_ms - visit.at_ms for visit in shipped[0].visits.values() if visit.closed_at_ms]
    assert len(lasted) > 20
    assert min(lasted) > NINE_MINUTES_MS - BESIDE_MS
    assert max(lasted) < NINE_MINUTES_MS + CLOSE_DELAY_MAX_MS + BESIDE_MS
