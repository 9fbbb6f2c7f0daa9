"""Somebody acts for a person who cannot: given by two officers, accepted, limited, noted, ended."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.chain.block import Receipt
from consensus.primitives.encoding import encode_value
from consensus.rights.mandates import ACCEPT_MS, ACTS, APPROVE_MS, LASTS_MAX_MS
from consensus.state.consent import effective_consent, read_choices
from contracts.lifecycle.registry import read_source
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person, data_of
from tests.unit.contracts.privacy.test_officers import move

PAPERS = b"\x07" * 32
STEP_MS = 300_000


class Family:
    """A child, a mother, two officers; what they do about mandates, and how the chain answers."""

    def __init__(self, hospital: Hospital) -> None:
        self.hospital = hospital
        self.child, self.mother = hospital.enrol("child"), hospital.enrol("mother")
        self.first, self.second = hospital.enrol("first", "officer"), hospital.enrol("second", "officer")
        self.until_ms = hospital.bucket() + 30 * DAY_MS

    def arguments(self, **changes: Any) -> list[Any]:
        values: dict[str, Any] = {
            "handle": self.child.handle,
            "representative": self.mother.handle,
            "papers": PAPERS,
            "acts": ["consent"],
            "until_ms": self.until_ms,
        }
        return list((values | changes).values())

    def propose(self, **changes: Any) -> bytes:
        return self.hospital.must(self.first.identity, "mandates", "propose", *self.arguments(**changes)).txid

    def approve(self, mandate_id: bytes) -> bytes:
        self.hospital.must(self.second.identity, "mandates", "approve", mandate_id)
        return mandate_id

    def give(self, **changes: Any) -> bytes:
        """A mandate that is in force."""
        mandate_id = self.approve(self.propose(**changes))
        self.hospital.must(self.mother.identity, "mandates", "accept", mandate_id)
        return mandate_id

    def refusal(self, person: Person, entry: str, *arguments: Any) -> str:
        receipt = self.hospital.send(person.identity, "mandates", entry, *arguments)
        assert not receipt.ok
        return receipt.code

    def say(self, person: Person, entry: str, *rest: Any, of: Person | None = None) -> Receipt:
        """Somebody says something about what is recorded of the child."""
        seen = [self.hospital.height] if entry == "give" else []
        return self.hospital.send(person.identity, "consent", entry, (of or self.child).handle, *rest, *seen)

    def yes(self, person: Person, purposes: tuple[str, ...] = ("research",), until_ms: int | None = None) -> str:
        end_ms = self.until_ms if until_ms is None else until_ms
        return self.say(person, "give", list(purposes), ["depth"], 0, end_ms, 0).code

    def allowed(self, purpose: str = "research") -> bool:
        """Whether the child may be recorded, once what was said counts: as the contract and as a robot reads it."""
        self.hospital.block([])
        told = self.hospital.view("consent", "allowed", self.child.handle, purpose, "depth")
        steps = read_choices(self.hospital.value("consent", b"of/" + self.child.handle)).get((purpose, "depth"), ())
        step = effective_consent(steps, self.hospital.height)
        now = self.hospital.time_ms
        open_now = step is not None and step.from_ms <= now and (not step.until_ms or now < step.until_ms)
        assert open_now == told
        return bool(told)

    def trail(self, mandate_id: bytes) -> list[tuple[str, list[str]]]:
        acts = self.hospital.view("mandates", "trail", mandate_id, 0, 200)
        return [(act["kind"], act["data"]["purposes"]) for act in acts]


@pytest.fixture
def family(hospital: Hospital) -> Family:
    return Family(hospital)


def test_two_officers_give_it_the_mother_accepts_speaks_and_the_trail_names_it_all(family: Family) -> None:
    hospital, mandate_id = family.hospital, family.propose()
    assert family.yes(family.mother) == "NOT_THE_MEMBER", "a proposal is no mandate"
    family.approve(mandate_id)
    assert family.yes(family.mother) == "NOT_THE_MEMBER", "nor before she accepts it"
    hospital.must(family.mother.identity, "mandates", "accept", mandate_id)
    told = family.say(family.mother, "give", ["research"], ["depth"], 0, family.until_ms, 0)
    assert data_of(told, "given")["mandate"] == mandate_id
    assert data_of(told, "acted") == {"mandate_id": mandate_id, "kind": "given", "number": 0}
    assert family.allowed()
    assert family.say(family.mother, "refuse", ["demo"], []).ok
    hospital.must(family.mother.identity, "rights", "object_to", family.child.handle, ["care"])
    assert family.say(family.mother, "withdraw", [], []).ok
    assert not family.allowed()
    assert family.trail(mandate_id) == [
        ("given", ["research"]),
        ("refused", ["demo"]),
        ("objected", ["care"]),
        ("withdrawn", []),
    ]
    (first, *_) = hospital.view("mandates", "trail", mandate_id, 0, 1)
    assert (first["txid"], first["data"]["until_ms"]) == (told.txid, family.until_ms)
    entry = hospital.view("mandates", "mandate", mandate_id)
    officers = (family.first.identity.public_key, family.second.identity.public_key)
    assert (entry["proposer"], entry["approver"], entry["papers"], entry["org"]) == (*officers, PAPERS, "ward")
    assert hospital.view("mandates", "mandates", 0, 10) == [mandate_id]


def test_what_was_given_ends_with_the_mandate_whoever_ends_it(family: Family) -> None:
    for person in (family.child, family.mother, family.first, family.second):
        mandate_id = family.give()
        assert family.yes(family.mother) == "OK"
        assert family.allowed()
        family.hospital.must(person.identity, "mandates", "end", mandate_id)
        assert not family.allowed()
        assert family.yes(family.mother) == "NOT_THE_MEMBER"
        entry = family.hospital.view("mandates", "mandate", mandate_id)
        assert (entry["status"], entry["ended_by"]) == ("ended", person.identity.public_key)
        assert family.refusal(person, "end", mandate_id) == "MANDATE_ENDED"


def test_what_the_person_gave_herself_outlasts_the_mandate(family: Family) -> None:
    assert family.say(family.child, "give", ["demo"], ["depth"], 0, 0, 0).ok
    mandate_id = family.give()
    assert family.yes(family.mother, ("research", "demo")) == "OK"
    assert family.say(family.child, "give", ["demo"], ["depth"], 0, 0, 0).ok, "her own yes takes its place"
    family.hospital.must(family.mother.identity, "mandates", "end", mandate_id)
    assert not family.allowed("research")
    assert family.allowed("demo")


def test_a_yes_of_her_own_that_is_still_to_come_outlasts_it_and_bridges_nothing(family: Family) -> None:
    hospital, mandate_id = family.hospital, family.give()
    assert family.yes(family.mother) == "OK"
    later = hospital.height + 6
    assert family.say(family.child, "give", ["research"], ["depth"], 0, 0, later).ok
    assert family.allowed()
    hospital.must(family.mother.identity, "mandates", "end", mandate_id)
    while hospital.height < later - 1:
        assert not family.allowed()
    assert family.allowed()


def test_a_no_of_her_own_stands_above_the_mandate_until_she_says_yes(family: Family) -> None:
    mandate_id = family.give()
    for no in ("refuse", "withdraw"):
        assert family.yes(family.mother) == "OK"
        assert family.say(family.child, no, ["research"], []).ok
        assert family.yes(family.mother) == "OWN_NO_STANDS"
        assert family.say(family.mother, "refuse", ["research"], []).ok
        assert family.say(family.mother, "withdraw", [], []).ok
        assert family.yes(family.mother) == "OWN_NO_STANDS", "a no of the mother's does not take the child's away"
        assert not family.allowed()
        assert family.say(family.child, "give", ["research"], ["depth"], 0, 0, 0).ok
        assert family.say(family.mother, "refuse", ["research"], ["depth"]).ok
        assert not family.allowed(), "a no of either counts"
    family.hospital.must(family.child.identity, "rights", "object_to", family.child.handle, ["care"])
    assert family.yes(family.mother, ("care",)) == "OWN_NO_STANDS"
    family.hospital.must(family.mother.identity, "mandates", "end", mandate_id)
    family.give()
    assert family.yes(family.mother, ("care",)) == "OWN_NO_STANDS", "also under the next one"


def test_a_yes_of_her_own_that_is_still_to_come_opens_nothing_to_others(family: Family) -> None:
    """Her no holds until her own yes does: the representative's yes is refused, and her no ends that yes alone."""
    hospital, choice = family.hospital, (["research"], ["depth"])
    family.give()
    for no in ("refuse", "withdraw"):
        assert family.say(family.child, "refuse", *choice).ok
        assert family.say(family.child, "give", *choice, 0, 0, hospital.height + 1000).ok
        assert family.yes(family.mother) == "OWN_NO_STANDS"
        assert family.say(family.mother, no, *choice).ok
        assert family.yes(family.mother) == "OWN_NO_STANDS"
        (step,) = read_choices(hospital.value("consent", b"of/" + family.child.handle))["research", "depth"]
        assert (step.status, step.mandate) == ("refused", b"")
    assert not family.allowed()


@pytest.mark.parametrize("no", ["refuse", "withdraw all", "nothing"])
@pytest.mark.parametrize("begins", [0, 20 * DAY_MS])
@pytest.mark.parametrize("ends", [0, 25 * DAY_MS])
def test_no_yes_for_her_goes_beyond_her_own_in_time(family: Family, no: str, begins: int, ends: int) -> None:
    """Her own yes is of a period: outside of it what she said before stands, also once it is over."""
    hospital, choice = family.hospital, (["research"], ["depth"])
    family.give()
    if no != "nothing":
        assert family.say(family.child, no.split(maxsplit=1)[0], *(([], []) if no.endswith("all") else choice)).ok
    start = hospital.bucket()
    from_ms, until_ms = start + begins if begins else 0, start + ends if ends else 0
    assert family.say(family.child, "give", *choice, from_ms, until_ms, 0).ok
    hospital.block([])
    within = "OWN_NO_STANDS" if begins else "OK"
    assert family.yes(family.mother, until_ms=start + 22 * DAY_MS) == within
    assert family.allowed() == (within == "OK")
    assert family.yes(family.mother) == ("OWN_NO_STANDS" if ends else within)
    inside = family.say(family.mother, "give", *choice, start + 20 * DAY_MS, start + 22 * DAY_MS, 0)
    assert inside.ok, "within her own period anything goes"
    hospital.time_ms = start + 21 * DAY_MS
    assert family.allowed()
    hospital.time_ms = start + 26 * DAY_MS
    assert family.yes(family.mother) == ("OWN_NO_STANDS" if ends else "OK")
    assert family.allowed() != bool(ends)
    assert family.say(family.child, "give", *choice, 0, 0, 0).ok
    assert family.allowed()


def test_a_no_for_her_leaves_her_own_yes_known(family: Family) -> None:
    """Whoever acts for her says no and yes again, as far as her own yes goes, and no further."""
    end_ms = family.hospital.bucket() + DAY_MS
    family.give()
    assert family.yes(family.child, until_ms=end_ms) == "OK"
    assert family.say(family.mother, "refuse", ["research"], ["depth"]).ok
    assert not family.allowed()
    assert family.yes(family.mother) == "OWN_NO_STANDS"
    assert family.yes(family.mother, until_ms=end_ms) == "OK"
    assert family.allowed()


def test_a_no_that_changes_nothing_leaves_nothing_in_the_trail(family: Family) -> None:
    mandate_id = family.give()
    for _ in range(3):
        assert family.say(family.mother, "withdraw", ["research"], []).ok
        assert family.say(family.mother, "refuse", ["demo"], ["depth"]).ok
        assert family.say(family.mother, "refuse", ["demo"], ["depth"]).ok
        family.hospital.must(family.mother.identity, "rights", "object_to", family.child.handle, ["demo"])
    assert family.say(family.child, "refuse", ["care"], []).ok
    assert family.say(family.mother, "refuse", ["care"], []).ok
    assert family.trail(mandate_id) == [("refused", ["demo"]), ("objected", ["demo"])]


@pytest.mark.parametrize("own_is_last", [False, True])
def test_of_two_yeses_the_later_one_stands_and_ends_with_its_mandate(family: Family, own_is_last: bool) -> None:
    mandate_id = family.give()
    for is_own in (not own_is_last, own_is_last):
        assert family.yes(family.child if is_own else family.mother) == "OK"
        assert family.allowed()
    family.hospital.must(family.mother.identity, "mandates", "end", mandate_id)
    assert family.allowed() == own_is_last


def test_a_day_takes_64_acts_under_a_mandate_and_every_no(family: Family) -> None:
    hospital, mandate_id = family.hospital, family.give()
    for _ in range(32):
        assert family.yes(family.mother) == "OK"
        assert family.say(family.mother, "withdraw", [], []).ok
    assert family.yes(family.mother) == "WORDS_TOO_MANY"
    assert family.say(family.child, "give", ["research"], ["depth"], 0, 0, 0).ok, "the person herself goes on"
    assert family.say(family.mother, "refuse", ["research"], ["depth"]).ok
    assert not family.allowed()
    assert len(hospital.view("mandates", "trail", mandate_id, 0, 128)) == 65
    hospital.time_ms += DAY_MS
    assert family.yes(family.mother) == "OK"


def test_a_no_in_the_same_block_as_the_end_stays_her_own(family: Family) -> None:
    hospital, mandate_id = family.hospital, family.give()
    assert family.yes(family.mother) == "OK"
    no = hospital.sign(family.child.identity, "consent", "refuse", family.child.handle, ["research"], ["depth"])
    end = hospital.sign(family.mother.identity, "mandates", "end", mandate_id)
    assert all(receipt.ok for receipt in hospital.block([no, end]))
    family.give()
    assert family.yes(family.mother) == "OWN_NO_STANDS"


def test_a_giving_ends_with_the_mandate_at_the_latest(family: Family) -> None:
    family.give()
    for until_ms in (0, family.until_ms + STEP_MS):
        assert family.yes(family.mother, until_ms=until_ms) == "BEYOND_MANDATE"
    assert family.yes(family.mother) == "OK"
    assert family.allowed()
    family.hospital.time_ms = family.until_ms - 100
    assert not family.allowed()
    assert family.say(family.mother, "withdraw", [], []).code == "NOT_THE_MEMBER"


def test_a_giving_that_was_held_back_does_not_undo_a_later_word(family: Family) -> None:
    family.give()
    seen = family.hospital.height
    assert family.say(family.child, "withdraw", [], []).ok
    arguments = [["research"], ["depth"], 0, family.until_ms, 0, seen]
    late = family.hospital.send(family.mother.identity, "consent", "give", family.child.handle, *arguments)
    assert late.code == "WORD_OLDER"


def test_the_representative_speaks_for_the_person_of_the_mandate_by_the_key_that_is_hers_now(family: Family) -> None:
    other = family.hospital.enrol("other")
    mandate_id = family.give()
    assert family.say(family.mother, "withdraw", [], [], of=other).code == "NOT_THE_MEMBER"
    assert family.say(family.child, "withdraw", [], [], of=family.mother).code == "NOT_THE_MEMBER", "nor the other way"
    assert family.yes(family.first) == "NOT_THE_MEMBER", "who gave it has no part in it"
    family.hospital.must(family.hospital.admin, "identity", "revoke", family.mother.handle)
    assert family.yes(family.mother) == "NOT_THE_MEMBER"
    assert family.refusal(family.mother, "end", mandate_id) == "NOT_OF_THE_MANDATE"


# When it holds no more


def revoke_mother(family: Family) -> None:
    family.hospital.must(family.hospital.admin, "identity", "revoke", family.mother.handle)


def pass_time(family: Family) -> None:
    family.hospital.time_ms = family.until_ms


def remove_house(family: Family) -> None:
    value = encode_value(family.hospital.time_ms + 1)
    family.hospital.state.absorb({b"identity\x00removed/ward": value}, {}, family.hospital.state.state_root)
    family.hospital.time_ms += 100


def represent_mother(family: Family) -> None:
    aunt = family.hospital.enrol("aunt")
    arguments = family.arguments(handle=family.mother.handle, representative=aunt.handle)
    mandate_id = family.hospital.must(family.first.identity, "mandates", "propose", *arguments).txid
    family.approve(mandate_id)
    family.hospital.must(aunt.identity, "mandates", "accept", mandate_id)


@pytest.mark.parametrize("cause", [revoke_mother, pass_time, remove_house, represent_mother])
def test_it_holds_no_more_and_anybody_who_is_a_member_has_it_closed(family: Family, cause: Any) -> None:
    hospital, mandate_id = family.hospital, family.give()
    assert family.yes(family.mother) == "OK"
    ben = hospital.enrol("ben")
    assert family.refusal(ben, "close", mandate_id) == "MANDATE_HOLDS"
    cause(family)
    assert (
        hospital.view("mandates", "acting_for", family.child.handle, family.mother.identity.public_key, "consent")
        is None
    )
    assert family.yes(family.mother) != "OK"
    hospital.must(ben.identity, "mandates", "close", mandate_id)
    assert not family.allowed()
    assert family.refusal(ben, "close", mandate_id) == "MANDATE_ENDED"


def test_who_left_or_was_revoked_is_represented_no_more(family: Family) -> None:
    mandate_id = family.give()
    family.hospital.must(family.child.identity, "identity", "leave", family.child.handle)
    assert family.yes(family.mother) == "NOT_THE_MEMBER"
    family.hospital.must(family.first.identity, "mandates", "end", mandate_id)
    assert family.hospital.view("consent", "choices", family.child.handle) == {}


def test_the_next_proposal_closes_one_that_is_over_and_waits_for_one_that_is_not(family: Family) -> None:
    hospital, before = family.hospital, family.give()
    assert family.yes(family.mother) == "OK"
    assert family.refusal(family.first, "propose", *family.arguments()) == "MANDATE_EXISTS"
    hospital.time_ms = family.until_ms
    family.until_ms += 30 * DAY_MS
    after = family.propose()
    assert hospital.view("mandates", "mandate", before)["status"] == "ended"
    assert not family.allowed()
    assert family.refusal(family.second, "propose", *family.arguments()) == "MANDATE_EXISTS"
    hospital.time_ms += APPROVE_MS + 1
    assert family.propose() != after, "a proposal that nobody approved in time stops nobody"


def test_each_of_the_three_agrees_in_time(family: Family) -> None:
    hospital, late = family.hospital, family.propose()
    proposed_ms = hospital.time_ms
    hospital.time_ms = proposed_ms + APPROVE_MS
    assert family.refusal(family.second, "approve", late) == "MANDATE_LAPSED"
    in_time = family.propose()
    hospital.time_ms += APPROVE_MS - 100
    family.approve(in_time)
    approved_ms = hospital.time_ms
    hospital.time_ms = approved_ms + ACCEPT_MS
    assert family.refusal(family.mother, "accept", in_time) == "MANDATE_LAPSED"
    hospital.time_ms = approved_ms + ACCEPT_MS - 100
    hospital.must(family.mother.identity, "mandates", "accept", in_time)


def test_steps_come_in_order_and_once(family: Family) -> None:
    mandate_id = family.propose()
    assert family.refusal(family.mother, "accept", mandate_id) == "MANDATE_DECIDED"
    family.approve(mandate_id)
    assert family.refusal(family.second, "approve", mandate_id) == "MANDATE_DECIDED"
    family.hospital.must(family.mother.identity, "mandates", "accept", mandate_id)
    assert family.refusal(family.mother, "accept", mandate_id) == "MANDATE_DECIDED"


def test_a_proposal_ends_by_the_person_herself_before_anybody_acts(family: Family) -> None:
    for mandate_id in (family.propose(), None):
        before = mandate_id or family.approve(family.propose())
        family.hospital.must(family.child.identity, "mandates", "end", before)
        assert family.refusal(family.second, "approve", before) == "MANDATE_DECIDED"
        assert family.refusal(family.mother, "accept", before) == "MANDATE_DECIDED"


# Who may


def test_nobody_but_two_officers_of_that_house_gives_it(family: Family) -> None:
    hospital = family.hospital
    foreign, nurse = hospital.enrol("foreign", "officer"), hospital.enrol("nurse", "staff")
    move(hospital, foreign, org="elsewhere")
    mandate_id = family.propose()
    for person in (foreign, nurse, hospital.robot, family.child, family.mother):
        assert family.refusal(person, "propose", *family.arguments()) == "NOT_AN_OFFICER"
        assert family.refusal(person, "approve", mandate_id) == "NOT_AN_OFFICER"
    assert family.refusal(foreign, "end", mandate_id) == "NOT_OF_THE_MANDATE"
    assert family.refusal(family.first, "approve", mandate_id) == "OFFICER_THE_SAME"
    family.approve(mandate_id)
    for person in (family.first, family.child, nurse):
        assert family.refusal(person, "accept", mandate_id) == "NOT_THE_REPRESENTATIVE"


def test_neither_of_the_two_officers_is_the_representative(family: Family) -> None:
    to_first = family.arguments(representative=family.first.handle)
    assert family.refusal(family.first, "propose", *to_first) == "OFFICER_CONCERNED"
    to_second = family.propose(representative=family.second.handle)
    assert family.refusal(family.second, "approve", to_second) == "OFFICER_CONCERNED"
    third = family.hospital.enrol("third", "officer")
    family.hospital.must(third.identity, "mandates", "approve", to_second)
    family.hospital.must(family.second.identity, "mandates", "accept", to_second)
    assert family.yes(family.second) == "OK"


def test_who_is_an_officer_no_more_has_given_nothing(family: Family) -> None:
    hospital, waiting = family.hospital, family.propose()
    hospital.must(hospital.admin, "identity", "revoke", family.first.handle)
    assert family.refusal(family.second, "approve", waiting) == "OFFICER_GONE"
    hospital.must(family.child.identity, "mandates", "end", waiting)
    family.first = hospital.enrol("third", "officer")
    approved = family.approve(family.propose())
    hospital.must(hospital.admin, "identity", "revoke", family.second.handle)
    assert family.refusal(family.mother, "accept", approved) == "OFFICER_GONE"


def test_only_one_who_acts_for_herself_represents_and_only_a_subject_is_represented(family: Family) -> None:
    hospital = family.hospital
    nurse, auditor = hospital.enrol("nurse", "staff"), hospital.enrol("auditor", "auditor")
    for changes, code in (
        ({"handle": nurse.handle}, "REPRESENTED_WRONG"),
        ({"handle": hospital.robot.handle}, "REPRESENTED_WRONG"),
        ({"representative": hospital.robot.handle}, "REPRESENTATIVE_WRONG"),
        ({"representative": auditor.handle}, "REPRESENTATIVE_WRONG"),
        ({"representative": family.child.handle}, "REPRESENTATIVE_WRONG"),
    ):
        assert family.refusal(family.first, "propose", *family.arguments(**changes)) == code
    family.give()
    sister = hospital.enrol("sister")
    chained = family.arguments(handle=sister.handle, representative=family.child.handle)
    assert family.refusal(family.first, "propose", *chained) == "REPRESENTATIVE_WRONG"
    revoke_mother(family)
    other = family.arguments(handle=sister.handle)
    assert family.refusal(family.first, "propose", *other) == "REPRESENTATIVE_WRONG"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"handle": b"x"}, "HANDLE_SIZE_WRONG"),
        ({"handle": bytes(32)}, "HANDLE_UNKNOWN"),
        ({"representative": b"x"}, "HANDLE_SIZE_WRONG"),
        ({"representative": bytes(32)}, "HANDLE_UNKNOWN"),
        ({"papers": b""}, "PAPERS_WRONG"),
        ({"papers": bytes(33)}, "PAPERS_WRONG"),
        ({"acts": []}, "ACT_UNKNOWN"),
        ({"acts": ["everything"]}, "ACT_UNKNOWN"),
        ({"acts": [5]}, "ACT_UNKNOWN"),
        ({"acts": ["consent"] * 2}, "ACT_UNKNOWN"),
    ],
)
def test_a_proposal_says_who_what_and_by_which_papers(family: Family, changes: dict[str, Any], code: str) -> None:
    assert family.refusal(family.first, "propose", *family.arguments(**changes)) == code


@pytest.mark.parametrize(
    ("later_ms", "code"),
    [(1, "PERIOD_WRONG"), (-31 * DAY_MS, "PERIOD_WRONG"), (LASTS_MAX_MS, "PERIOD_WRONG"), (DAY_MS, "OK")],
)
def test_it_lasts_a_year_at_most(family: Family, later_ms: int, code: str) -> None:
    arguments = family.arguments(until_ms=family.until_ms + later_ms)
    assert family.hospital.send(family.first.identity, "mandates", "propose", *arguments).code == code


def test_there_is_nothing_to_do_of_a_mandate_that_is_none(family: Family) -> None:
    for unknown in (bytes(32), b"x"):
        for entry in ("approve", "accept", "end", "close"):
            assert family.refusal(family.first, entry, unknown) == "MANDATE_UNKNOWN"


def test_wallet_and_contract_know_the_same_bounds() -> None:
    source = read_source("mandates")
    for name, value in (("APPROVE_MS", APPROVE_MS), ("ACCEPT_MS", ACCEPT_MS), ("LASTS_MAX_MS", LASTS_MAX_MS)):
        assert f"\n{name} = {value}\n" in source
    assert f"\nACTS = ({', '.join(repr(act) for act in ACTS)},)\n".replace("'", '"') in source


@pytest.mark.parametrize("named", [([], []), ([], ["depth"]), (["research"], []), (["research"], ["depth"])])
@pytest.mark.parametrize("before", ["nothing", "her own yes", "a no of the mother's"])
def test_whatever_she_took_back_herself_nobody_gives_for_her_until_she_gives_it_again(
    family: Family, named: tuple[list[str], list[str]], before: str
) -> None:
    family.give()
    family.hospital.block([])
    if before == "her own yes":
        assert family.yes(family.child) == "OK"
    elif before == "a no of the mother's":
        assert family.yes(family.mother) == "OK"
        family.hospital.block([])
        assert family.say(family.mother, "withdraw", [], []).ok
    family.hospital.block([])
    assert family.say(family.child, "withdraw", *named).ok
    family.hospital.block([])

    assert family.yes(family.mother) == "OWN_NO_STANDS"
    assert not family.allowed()
    assert family.yes(family.child) == "OK"
    family.hospital.block([])
    family.hospital.block([])
    assert family.yes(family.mother) == "OK"
    assert family.yes(family.mother, ("care",)) == ("OK" if named[0] else "OWN_NO_STANDS")


def test_an_officer_proposes_64_mandates_a_day_whatever_is_ended_and_whatever_key_proposes(family: Family) -> None:
    hospital, first = family.hospital, family.first
    for _ in range(64):
        hospital.must(first.identity, "mandates", "end", family.propose())
    assert family.refusal(first, "propose", *family.arguments()) == "WORDS_TOO_MANY"
    again = Person("first-again")
    hospital.must(first.identity, "identity", "rotate", *hospital.rotation_arguments(first, again))
    assert family.refusal(again, "propose", *family.arguments()) == "WORDS_TOO_MANY"
    others = hospital.must(family.second.identity, "mandates", "propose", *family.arguments()).txid
    hospital.must(family.second.identity, "mandates", "end", others)
    hospital.time_ms += DAY_MS
    hospital.must(again.identity, "mandates", "propose", *family.arguments())
