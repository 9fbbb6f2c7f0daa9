"""Whatever two people say in whatever order: nobody's yes goes beyond what a person said last herself.

The contract keeps at most two steps of a choice; the model keeps all that she said herself.
"""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from consensus.state.consent import GIVEN, STEPS_MAX_COUNT, StepRow, read_choices
from tests.unit.contracts.privacy.test_mandates import STEP_MS, Family, Hospital

AHEAD = 5
LATER_MS = 2 * STEP_MS


@dataclass(frozen=True)
class Saying:
    """What one of the two says next; `ahead` is how many blocks later a giving begins to hold.

    `begins` and `ends` are its period in steps of five minutes from now on; 0 is no bound, or the mandate's end.
    """

    own: bool
    entry: str
    ahead: int = 1
    begins: int = 0
    ends: int = 0


@dataclass(frozen=True)
class Yes:
    """How far a yes goes."""

    height: int
    from_ms: int
    until_ms: int

    def covers(self, other: Yes, height: int, time_ms: int) -> bool:
        """Whether this one holds in a block, and another that is said there stays within it."""
        ends = not self.until_ms or 0 < other.until_ms <= self.until_ms
        return self.height <= height and self.from_ms <= max(other.from_ms, time_ms) and ends


@dataclass(frozen=True)
class OwnWord:
    """A word of her own, and from which block on it counts; a no has no yes."""

    yes: Yes | None
    height: int
    everything: bool = False


ENTRIES = ["give", "give", "give", "refuse", "withdraw", "withdraw all", "wait", "later"]
SAYINGS = st.lists(
    st.builds(
        Saying,
        st.booleans(),
        st.sampled_from(ENTRIES),
        st.integers(1, AHEAD),
        st.sampled_from([0, 0, 2, 3]),
        st.sampled_from([0, 0, 4, 5]),
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
        self.last: OwnWord | None = None
        self.others: dict[Yes, list[OwnWord]] = {}
        """Each yes of the mother's, with what the child said since."""

    def own_words(self, height: int) -> list[OwnWord]:
        return [word for word in self.said if word.height <= height]

    def steps(self) -> tuple[StepRow, ...]:
        row = self.hospital.value("consent", b"of/" + self.child.handle)
        return read_choices(row).get(("research", "depth"), ())

    def step_at(self, height: int) -> StepRow | None:
        return next((step for step in reversed(self.steps()) if step.height <= height), None)

    def yes_of(self, saying: Saying) -> Yes:
        """What a giving names, said in the next block."""
        now, open_end = self.hospital.bucket(), 0 if saying.own else self.family.until_ms
        begins = now + saying.begins * STEP_MS if saying.begins else 0
        ends = now + saying.ends * STEP_MS if saying.ends else open_end
        return Yes(self.hospital.height + 1 + saying.ahead, begins, ends)

    def fits(self, saying: Saying, yes: Yes | None) -> bool:
        """Whether it might be said in this block: whatever is her own, every no, and a yes within her own last word."""
        if saying.own or yes is None or self.last is None:
            return True
        return self.last.yes is not None and self.last.yes.covers(yes, self.hospital.height, self.hospital.time_ms)

    def say(self, saying: Saying) -> None:
        if saying.entry in ("wait", "later"):
            self.hospital.time_ms += LATER_MS if saying.entry == "later" else 0
            self.hospital.block([])
            return
        person = self.child if saying.own else self.family.mother
        before = self.steps()
        yes = self.yes_of(saying) if saying.entry == "give" else None
        rest = [yes.from_ms, yes.until_ms, yes.height] if yes else []
        entry, _, everything = saying.entry.partition(" ")
        choices: tuple[list[str], list[str]] = ([], []) if everything else (["research"], ["depth"])
        receipt = self.family.say(person, entry, *choices, *rest)
        said = self.hospital.height
        fits = self.fits(saying, yes)
        assert receipt.code == ("OK" if fits else "OWN_NO_STANDS")
        if not fits:
            assert self.steps() == before
            return
        if entry == "withdraw" and not saying.own and (not before or before[-1].status != GIVEN):
            assert self.steps() == before
            return
        self.said = self.own_words(said)  # any word ends what was still to come
        if saying.own:
            self.last = OwnWord(yes, yes.height if yes else said + 1, bool(everything))
            self.said.append(self.last)
            for since in self.others.values():
                since.append(self.last)
        elif yes:
            self.others[yes] = []
        if not yes and not everything:
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
                assert own[-1].everything or (step and not step.mandate), "and stays hers, whoever says no as well"
            if step and step.status == GIVEN and step.mandate:
                since = self.others[Yes(step.height, step.from_ms, step.until_ms)]
                assert not any(word in own for word in since), "her own later word takes its place"


NO, NOTHING = Saying(True, "refuse"), Saying(True, "withdraw all")
HERS, OTHERS = Saying(True, "give"), Saying(False, "give")


@example([NO, Saying(True, "give", 5), OTHERS])
@example([NO, Saying(True, "give", 5), Saying(False, "refuse"), OTHERS])
@example([NO, Saying(True, "give", 5), Saying(False, "withdraw"), OTHERS])
@example([NOTHING, OTHERS])
@example([NOTHING, Saying(True, "give", 2), OTHERS])
@example([NOTHING, Saying(True, "give", 1), Saying(False, "refuse"), OTHERS])
@example([Saying(True, "withdraw"), OTHERS])
@example([NO, Saying(True, "give", begins=3), OTHERS])
@example([NO, Saying(True, "give", ends=4), Saying(False, "give", ends=4), Saying(True, "wait"), OTHERS])
@example([NO, Saying(True, "give", ends=4), *[Saying(True, "later")] * 3, OTHERS])
@example([Saying(True, "give", ends=4), OTHERS])
@example([Saying(True, "give", begins=2, ends=5), Saying(False, "give", begins=3, ends=4)])
@example([HERS, OTHERS, Saying(False, "refuse"), OTHERS])
@settings(suppress_health_check=[HealthCheck.too_slow])
@given(SAYINGS)
def test_no_yes_of_anothers_holds_against_her_own_no(sayings: list[Saying]) -> None:
    story = Story()
    for saying in sayings:
        story.say(saying)
        story.check()
