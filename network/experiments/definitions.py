"""The four experiments: people, scenario and published run to compare with."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources

from clients.robot.synthetic.scenario import Scenario, parse_scenario
from network.experiments.published_figures import RUN_1, RUN_2, PublishedRun


@dataclass(frozen=True, slots=True)
class Experiment:
    """One experiment. Registered `people` outside the scene have to end with nothing."""

    number: int
    title: str
    question: str
    scenario_file: str
    people: tuple[str, ...]
    corrupts: bool
    beside: PublishedRun

    @property
    def name(self) -> str:
        return f"experiment-{self.number}"

    def load_scenario(self) -> Scenario:
        file = resources.files("clients.robot") / "scenarios" / self.scenario_file
        return parse_scenario(file.read_text(encoding="utf-8"))


EXPERIMENTS = (
    Experiment(
        1,
        "One person",
        "Does a person get the frames in which they were, all of them, and nobody else any?",
        "experiment-1.toml",
        ("patient-a", "patient-b"),
        corrupts=False,
        beside=RUN_1,
    ),
    Experiment(
        2,
        "One person, and data corrupted off-chain",
        "Is a change to what is stored beside the chain found, and only that?",
        "experiment-1.toml",
        ("patient-a", "patient-b"),
        corrupts=True,
        beside=RUN_1,
    ),
    Experiment(
        3,
        "Two people, one after the other",
        "Does each get their own frames, also where the time around their tag's reading reaches into the other's?",
        "experiment-3.toml",
        ("patient-a", "patient-b"),
        corrupts=False,
        beside=RUN_2,
    ),
    Experiment(
        4,
        "Two people at once, among four tags",
        "Does each see themselves alone while others stand in the same picture?",
        "experiment-4.toml",
        ("patient-a", "patient-b"),
        corrupts=False,
        beside=RUN_2,
    ),
)
