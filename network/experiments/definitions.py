"""The experiments: people, scenario and published run to compare with. The first four are the paper's."""

from __future__ import annotations

from dataclasses import dataclass

from clients.robot.synthetic.driving.drive_file import load_shipped_scene
from clients.robot.synthetic.scenario_bag import Scene
from network.experiments.published_figures import RUN_1, RUN_2, PublishedRun


@dataclass(frozen=True, slots=True)
class Experiment:
    """One experiment. Registered `people` outside the scene have to end with nothing."""

    number: int
    title: str
    question: str
    scenario: str
    people: tuple[str, ...]
    corrupts: bool
    beside: PublishedRun

    @property
    def name(self) -> str:
        return f"experiment-{self.number}"

    def load_scene(self) -> Scene:
        return load_shipped_scene(self.scenario)


EXPERIMENTS = (
    Experiment(
        1,
        "One person",
        "Does a person get the frames in which they were, all of them, and nobody else any?",
        "experiment-1",
        ("patient-a", "patient-b"),
        corrupts=False,
        beside=RUN_1,
    ),
    Experiment(
        2,
        "One person, and data corrupted off-chain",
        "Is a change to what is stored beside the chain found, and only that?",
        "experiment-1",
        ("patient-a", "patient-b"),
        corrupts=True,
        beside=RUN_1,
    ),
    Experiment(
        3,
        "Two people, one after the other",
        "Does each get their own frames, also where the time around their tag's reading reaches into the other's?",
        "experiment-3",
        ("patient-a", "patient-b"),
        corrupts=False,
        beside=RUN_2,
    ),
    Experiment(
        4,
        "Two people at once, among four tags",
        "Does each see themselves alone while others stand in the same picture?",
        "experiment-4",
        ("patient-a", "patient-b"),
        corrupts=False,
        beside=RUN_2,
    ),
    Experiment(
        5,
        "The robot drives through two rooms and a corridor",
        "Are people also recorded where the robot has no empty scene, each by themselves?",
        "experiment-5",
        ("patient-a", "patient-b"),
        corrupts=False,
        beside=RUN_2,
    ),
)
