"""Whatever two people say in whatever order: nobody's yes holds for a person whose own last word is a no.

The contract keeps at most two steps of a choice; the model keeps all that she said herself.
"""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from consensus.rights.consents import GIVEN, STEPS_MAX_COUNT, Step, read_choices
from tests.unit.contracts.privacy.test_mandates import Family, Hospital

AHEAD = 5


@dataclass(frozen=True)
class Saying:
    """What one of the two says next; `ahead` is how many blocks later a giving begins to hold."""

    own: bool
    entry: str
    ahead: int = 1


@dataclass(frozen=True)
class OwnWord:
    """A word of her own, and from which block on it counts."""

    yes: bool
    height: int
    everything: bool = False


SAYINGS = st.lists(
    st.builds(
        Saying,
        st.booleans(),
        st.sampled_from(["give", "give", "refuse", "withdraw", "withdraw all", "wait"]),
        st.integers(1, AHEAD),
    ),
    min_size=1,
    max_size=14,
)


class Story:
    """A child and her mother, told to the contract; the child's own words, in a list."""

    def __init__(self) -> None:
        self.family = Family(Hospital())
        self.family.give()
        self.child, self.hospital = self.family.child, self.family.hospital
        self.said: list[OwnWord] = []

    def own_words(self, height: int) -> list[OwnWord]:
        return [word for word in self.said if word.height <= height]

    def steps(self) -> tuple[Step, ...]:
        row = self.hospital.value("consent", b"of/" + self.child.handle)
        return read_choices(row).get(("research", "depth"), ())

    def step_at(self, height: int) -> Step | None:
        return next((step for step in reversed(self.steps()) if step.height <= height), None)

    def say(self, saying: Saying) -> None:
        if saying.entry == "wait":
            self.hospital.block([])
            return
        person = self.child if saying.own else self.family.mother
        rest: list[int] = []
        before, own_before = self.steps(), self.own_words(self.hospital.height + 1)
        if saying.entry == "give":
            rest = [0, 0 if saying.own else self.family.until_ms, self.hospital.height + 1 + saying.ahead]
        entry, _, everything = saying.entry.partition(" ")
        choices: tuple[list[str], list[str]] = ([], []) if everything else (["research"], ["depth"])
        receipt = self.family.say(person, entry, *choices, *rest)
        said, is_no = self.hospital.height, saying.entry != "give"
        if not receipt.ok:
            assert receipt.code == "OWN_NO_STANDS"
            assert (saying.own, is_no, [word.yes for word in own_before[-1:]]) == (False, False, [False])
            assert self.steps() == before
            return
        is_changed = self.steps() != before
        if entry == "withdraw" and not saying.own and (not before or before[-1].status != GIVEN):
            assert not is_changed
            return
        self.said = self.own_words(said)  # any word ends what was still to come
        if saying.own:
            self.said.append(OwnWord(not is_no, said + saying.ahead if not is_no else said + 1, bool(everything)))
        if is_no and not everything:
            step = self.step_at(said + 1)
            assert step, "a no of either counts from the next block on"
            assert step.status != GIVEN

    def check(self) -> None:
        steps = self.steps()
        assert len(steps) <= STEPS_MAX_COUNT
        for height in range(self.hospital.height, self.hospital.height + AHEAD + 2):
            own, step = self.own_words(height), self.step_at(height)
            if own and not own[-1].yes:
                assert step or own[-1].everything, "her own no is kept"
                assert not step or step.status != GIVEN, f"her own no counts at {height}: {steps}"


@example([Saying(True, "refuse"), Saying(True, "give", 5), Saying(False, "give")])
@example([Saying(True, "refuse"), Saying(True, "give", 5), Saying(False, "refuse"), Saying(False, "give")])
@example([Saying(True, "refuse"), Saying(True, "give", 5), Saying(False, "withdraw"), Saying(False, "give")])
@example([Saying(True, "withdraw all"), Saying(False, "give")])
@example([Saying(True, "withdraw"), Saying(False, "give")])
@settings(suppress_health_check=[HealthCheck.too_slow])
@given(SAYINGS)
def test_no_yes_of_anothers_holds_against_her_own_no(sayings: list[Saying]) -> None:
    story = Story()
    for saying in sayings:
        story.say(saying)
        story.check()
