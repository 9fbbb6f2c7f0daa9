"""Whatever people say in whatever order: what the contract keeps is what a list of all their words would say."""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from consensus.chain.transaction import Transaction
from consensus.state.consent import GIVEN, STEPS_MAX_COUNT, StepRow, effective_consent, read_choices
from tests.unit.contracts.privacy.hospital import Hospital, Person

AHEAD = 6
PERIOD_STEP_MS = 300_000
NOS = {"refuse": "refused", "withdraw": "withdrawn"}


@dataclass(frozen=True)
class Word:
    """Said in the block `said` at its time, it holds from `step.height`; what had been said until `seen` was known."""

    said: int
    said_ms: int
    seen: int
    step: StepRow


@dataclass(frozen=True)
class Saying:
    """What a block holds, or (if `held_back`) what is signed now and comes with the block after the next."""

    entry: str
    ahead: int = 0
    begins: int = 0
    lasts: int = 0
    held_back: bool = False


def is_in_order(said: list[int], word: Word) -> bool:
    """The rule of order: a no always counts, a giving only if everything that was said before it was known."""
    return word.step.status != GIVEN or all(height <= word.seen for height in said)


def answer_to(said: list[int], word: Word, time_ms: int) -> str:
    """The code of a word's receipt in a block of that time: a period that is over by then is none, in any order."""
    step = word.step
    if step.status == GIVEN and step.until_ms and step.until_ms <= max(step.from_ms, time_ms):
        return "PERIOD_WRONG"
    return "OK" if is_in_order(said, word) else "WORD_OLDER"


def is_idle(words: list[Word], word: Word) -> bool:
    """Tell whether a word takes back what she said no to already: it makes givings older, and says nothing new."""
    return word.step.status == "withdrawn" and bool(words) and words[-1].step.status != GIVEN


def standing_at(words: list[Word], height: int) -> list[Word]:
    """What is left of all words at a block: a word ends whatever is still to come."""
    standing: list[Word] = []
    for word in words:
        if word.said <= height:
            standing = [old for old in standing if old.step.height <= word.said]
            standing.append(word)
    return standing


def in_force(words: list[Word], height: int) -> StepRow | None:
    """The word that holds at a height, of those said until then."""
    reached = [word for word in standing_at(words, height) if word.step.height <= height]
    return reached[-1].step if reached else None


def dated(words: list[Word], word: Word) -> Word:
    """The rule of breaks: a giving keeps since when the one before it has held, if that one holds until then."""
    before = in_force(words, word.said)
    if word.step.status != GIVEN or before is None or before.status != GIVEN or before.from_ms > word.said_ms:
        return word
    soon = word.step.height == word.said + 1
    if before.until_ms and not (soon and before.until_ms > word.said_ms):
        return word
    return replace(word, step=msgspec.structs.replace(word.step, since_ms=max(before.since_ms, before.from_ms)))


SAYINGS = st.lists(
    st.lists(
        st.builds(
            Saying,
            st.sampled_from(["give", "give", "refuse", "withdraw"]),
            st.integers(0, AHEAD),
            st.integers(0, 1),
            st.integers(0, 2),
            st.booleans(),
        ),
        max_size=3,
    ),
    max_size=10,
)


class Story:
    """One person's words, told to the contract and kept in a list."""

    def __init__(self) -> None:
        self.hospital = Hospital()
        self.person, card = Person("ann"), self.hospital.card("ann")
        self.handle = card.handle
        arguments = self.hospital.register_arguments(self.person, card, purposes=[])
        self.hospital.must(self.person.identity, "identity", "register", *arguments)
        self.words: list[Word] = []
        self.said: list[int] = []

    def sign(self, saying: Saying) -> tuple[Transaction, Word]:
        now, base_ms = self.hospital.height, self.hospital.time_ms - self.hospital.time_ms % PERIOD_STEP_MS
        said = now + (3 if saying.held_back else 1)
        arguments: list[object] = [["care"], ["depth"]]
        if saying.entry != "give":
            step = StepRow(said + 1, NOS[saying.entry], 0, 0, 0, b"")
        else:
            begins = base_ms + PERIOD_STEP_MS if saying.begins else 0
            until = base_ms + (1 + saying.begins + saying.lasts) * PERIOD_STEP_MS if saying.lasts else 0
            height = said + saying.ahead if saying.ahead else 0
            arguments += [begins, until, height, now]
            step = StepRow(height or said + 1, GIVEN, 0, begins, until, b"")
        signed = self.hospital.sign(self.person.identity, "consent", saying.entry, self.handle, *arguments)
        return signed, Word(said, 0, now, step)

    def block(self, pending: list[tuple[Transaction, Word]]) -> None:
        receipts = self.hospital.block([transaction for transaction, _ in pending])
        for receipt, (_, word) in zip(receipts, pending, strict=True):
            assert receipt.code == answer_to(self.said, word, self.hospital.time_ms)
            if receipt.ok:
                self.said.append(word.said)
            if receipt.ok and not is_idle(self.words, word):
                said_ms = self.hospital.time_ms
                final = replace(word, said_ms=said_ms, step=msgspec.structs.replace(word.step, since_ms=said_ms))
                self.words.append(dated(self.words, final))
        self.check()

    def check(self) -> None:
        hospital, height = self.hospital, self.hospital.height
        force = in_force(self.words, height)
        opened = force is not None and force.status == GIVEN and force.from_ms <= hospital.time_ms
        opened = opened and (force.until_ms == 0 or hospital.time_ms < force.until_ms)  # type: ignore[union-attr]
        assert hospital.view("consent", "allowed", self.handle, "care", "depth") == opened
        steps = read_choices(hospital.value("consent", b"of/" + self.handle)).get(("care", "depth"), ())
        assert len(steps) <= STEPS_MAX_COUNT
        assert [step.height for step in steps] == sorted({step.height for step in steps})
        coming = [word.step for word in standing_at(self.words, height) if word.step.height > height]
        assert [step for step in steps if step.height > height] == coming
        held = [step for step in steps if step.height <= height]
        assert held[-1:] == ([force] if force else [])
        yes = force if force is not None and force.status == GIVEN else None
        no_comes = any(step.status != GIVEN for step in coming)
        seen = effective_consent(steps, height)
        assert seen == (None if no_comes else yes), "a robot acts on a no as soon as it stands there"


@example([[Saying("withdraw")], [Saying("withdraw")], [Saying("give")]], 1)
@example([[], [], [], [], [Saying("give"), Saying("give", 0, 0, 1, held_back=True)]], 189_850)
@settings(suppress_health_check=[HealthCheck.too_slow])
@given(SAYINGS, st.integers(1, 400_000))
def test_the_steps_that_are_kept_say_what_all_words_say(sayings: list[list[Saying]], pace_ms: int) -> None:
    story = Story()
    late: dict[int, list[tuple[Transaction, Word]]] = {}
    for block in sayings + [[] for _ in range(AHEAD + 3)]:
        now = story.hospital.height + 1
        pending = late.pop(now, [])
        for saying in block:
            told = story.sign(saying)
            if saying.held_back:
                late.setdefault(told[1].said, []).append(told)
            else:
                pending.append(told)
        story.block(pending)
        story.hospital.time_ms += pace_ms
