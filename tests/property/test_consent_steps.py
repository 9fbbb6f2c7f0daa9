"""Whatever people say in whatever order: what the contract keeps is what a list of all their words would say."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from consensus.records.consents import GIVEN, STEPS_MAX_COUNT, find_consent, read_choices
from tests.unit.contracts.privacy.hospital import Hospital, Person

AHEAD = 6


@dataclass(frozen=True)
class Word:
    """Said in the block `said`, holds from `height`."""

    said: int
    status: str
    height: int


def in_force(words: list[Word], height: int) -> str:
    """The rule in one place: a word ends givings that are still to come, and holds from its height on."""
    standing: list[Word] = []
    for word in words:
        standing = [old for old in standing if old.height <= word.said or old.status != GIVEN]
        standing.append(word)
    reached = [word for word in standing if word.height <= height]
    return reached[-1].status if reached else ""


SAYINGS = st.lists(
    st.tuples(st.sampled_from(["give", "refuse", "withdraw", "wait"]), st.integers(0, AHEAD), st.booleans()),
    max_size=12,
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(SAYINGS)
def test_the_steps_that_are_kept_say_what_all_words_say(sayings: list[tuple[str, int, bool]]) -> None:
    hospital = Hospital()
    person, card = Person("ann"), hospital.card("ann")
    arguments = hospital.register_arguments(person, card, purposes=[])
    hospital.must(person.identity, "identity", "register", *arguments)
    words: list[Word] = []
    for entry, ahead, same_block in sayings:
        height = hospital.height + 1
        transactions = []
        for _ in range(2 if same_block else 1):
            if entry == "give":
                more = [["care"], ["depth"], 0, 0, height + ahead if ahead else 0]
                transactions.append(hospital.sign(person.identity, "consent", "give", card.handle, *more))
                word = Word(height, GIVEN, height + max(1, ahead))
            elif entry != "wait":
                transactions.append(hospital.sign(person.identity, "consent", entry, card.handle, ["care"], ["depth"]))
                word = Word(height, {"refuse": "refused", "withdraw": "withdrawn"}[entry], height + 1)
        receipts = hospital.block(transactions)
        words += [word for receipt in receipts if receipt.ok]
        check(hospital, card.handle, words)
    for _ in range(AHEAD + 1):
        hospital.block([])
        check(hospital, card.handle, words)


def check(hospital: Hospital, handle: bytes, words: list[Word]) -> None:
    told = hospital.view("consent", "allowed", handle, "care", "depth")
    assert told == (in_force(words, hospital.height) == GIVEN)
    row = hospital.value("consent", b"of/" + handle)
    steps = read_choices(row).get(("care", "depth"), ())
    assert len(steps) <= STEPS_MAX_COUNT
    assert [step.height for step in steps] == sorted({step.height for step in steps})
    seen = find_consent(steps, hospital.height) is not None
    coming_no = any(word.height > hospital.height and word.status != GIVEN for word in words)
    assert seen == (told and not coming_no), "a robot acts on a no as soon as it stands there"
