"""The whole attack: plays days, attacks each scheme, compares the figures.

`ok`: every attack on ours is within 0.05 of guessing (95 % bound), and every attack expected to beat the prototype
does.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from network.bench.conditions import Condition, Result, count_cores, measure_conditions
from network.bench.processes import worker_pool
from network.lab.privacy.attacks.attacks_on_all import attack_all_schemes
from network.lab.privacy.attacks.attacks_on_insides import attack_insides
from network.lab.privacy.attacks.evidence import Evidence, gather
from network.lab.privacy.attacks.learner import has_boosting
from network.lab.privacy.hospital.attacked_custodian import keep_last_day
from network.lab.privacy.hospital.attacked_days import play, working_folder
from network.lab.privacy.hospital.population import draw_population
from network.lab.privacy.hospital.schemes import OURS, PROTOTYPE, SCHEMES
from network.lab.privacy.limits_table import limit_figures, limits_of
from network.lab.privacy.scoring import Rates

MUST_WIN_RATE = 0.95
MUST_WIN = ("dictionary", "link_key", "link_all", "enrolled", "present", "custodian_opens", "backup_opens")

Progress = Callable[[str], None]
Figure = float | list[str] | None


@dataclass(frozen=True, slots=True)
class AttackOptions:
    """People enrolled (as many not), days, seed; `serial_bits`: UID bits unknown to attackers; processes, 0: all cores."""

    people: int = 240
    days: int = 5
    seed: int = 1
    serial_bits: int = 20
    processes: int = 0
    on: str = ""  # a cluster's scheduler whose workers attack instead


def run_privacy_attack(options: AttackOptions, progress: Progress = lambda _: None) -> Result[dict[str, Figure]]:
    boosting = has_boosting()
    processes = options.processes or count_cores()
    conditions = measure_conditions(nodes=0, seed=options.seed, processes=options.on or processes)
    started = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="blockrobot-attack-", dir=working_folder()) as name,
        worker_pool(processes, options.on) as pool,
    ):
        folder = Path(name)
        progress(f"playing {options.days} days of {options.people} people")
        population = draw_population(
            options.seed, people=options.people, days=options.days, serial_bits=options.serial_bits
        )
        played = play(population, folder, seed=options.seed)
        evidence = gather(played, seed=options.seed, boosting=boosting)
        wait = attack_all_schemes(evidence, pool, progress)
        progress("the custodian follows, is copied, erases")
        custody = keep_last_day(played, folder / "custodian")
        inside, more = attack_insides(evidence, custody, folder, progress)
        limits = limits_of(evidence, custody, pool, progress)
        rates, figures = wait()
    rates |= inside
    figures |= more
    table: dict[str, Figure] = {}
    for attack, found in rates.items():
        for scheme in (scheme for scheme in SCHEMES if scheme in found):
            table |= found[scheme].figures(f"{attack}_{scheme}")
    table |= limit_figures(limits)
    table |= figures
    table["leaks_on_ours"] = [attack for attack, found in rates.items() if not found[OURS].is_guessing]
    table["attacks_too_weak"] = too_weak(rates)
    table["elapsed_s"] = round(time.monotonic() - started, 1)
    return Result(
        name="privacy attack",
        ok=not table["leaks_on_ours"] and not table["attacks_too_weak"],
        figures=table,
        conditions={**conditions, **_scale(options, evidence, boosting=boosting)},
    )


def too_weak(rates: Rates) -> list[str]:
    return [name for name in MUST_WIN if name not in rates or rates[name][PROTOTYPE].success < MUST_WIN_RATE]


def _scale(options: AttackOptions, evidence: Evidence, *, boosting: bool) -> dict[str, Condition]:
    return {
        "people": options.people,
        "days": options.days,
        "robots": evidence.played.population.robots,
        "visits": len(evidence.visits),
        "records": sum(len(visit.records) for visit in evidence.visits),
        "blocks": len(evidence.played.chain.blocks),
        "uid_bits_searched": options.serial_bits,
        "linker": "gradient boosting" if boosting else "logistic regression",
    }
