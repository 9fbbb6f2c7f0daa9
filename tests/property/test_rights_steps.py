"""Whatever is said of a visit in whatever order: the contract decides as one does who keeps a note for each record.

The contract holds one row a visit and judges by times; the oracle here writes down, record by record, until when it is
kept, and who may see it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from consensus.rights.right_codes import GROUNDS, KEEP_MS, KEEPING_GROUNDS, OWN_PURPOSES
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, key_of

RECORDS_COUNT = 3
Step = tuple[Any, ...]


@dataclass
class Note:
    """What somebody would write on the record's own sheet."""

    expires_ms: int
    kept_until_ms: int = 0
    is_erased: bool = False
    is_erasing: bool = False
    is_named: bool = False

    def is_there(self, now_ms: int) -> bool:
        return not self.is_erased and not self.is_erasing and max(self.expires_ms, self.kept_until_ms) > now_ms


@dataclass
class Oracle:
    """One visit: its sheets, and what was said of all of it."""

    notes: dict[bytes, Note] = field(default_factory=dict)
    is_whole: bool = False
    until_ms: int = 0
    is_denied: bool = False
    objected: set[str] = field(default_factory=set)
    breach: str = ""
    risk: str = ""
    told: set[str] = field(default_factory=set)

    @property
    def is_restricted(self) -> bool:
        return self.is_whole or any(note.is_named for note in self.notes.values())

    def record(self, record_id: bytes, expires_ms: int) -> None:
        self.notes[record_id] = Note(expires_ms, self.until_ms if self.is_whole else 0)

    def restrict(self, ids: list[bytes], ground: str, now_ms: int) -> bool:
        kept, keeps = self.until_ms > now_ms, ground in KEEPING_GROUNDS
        if self.is_denied or (kept and not keeps) or not all(self.notes[one].is_there(now_ms) for one in ids):
            return False
        if keeps and not kept:
            for note in self.notes.values():
                note.is_named = note.is_named and note.is_there(now_ms)
        for one in ids:
            self.notes[one].is_named = True
        self.is_whole = self.is_whole or not ids
        self.until_ms = now_ms + KEEP_MS if keeps else 0
        for note in self.notes.values():
            covered = (note.is_named or self.is_whole) and note.is_there(now_ms)
            note.kept_until_ms = self.until_ms if covered else 0
        return True

    def lift(self, ids: list[bytes]) -> bool:
        if self.is_denied or not self.is_restricted:
            return False
        if ids and (self.is_whole or not all(self.notes[one].is_named for one in ids)):
            return False
        for one in ids or list(self.notes):
            self.notes[one].is_named, self.notes[one].kept_until_ms = False, 0
        self.is_whole = False
        if not self.is_restricted:
            self.until_ms = 0
        return True

    def request(self, ids: list[bytes], purpose: str) -> bool:
        hit = self.is_whole or any(self.notes[one].is_named for one in ids) or (not ids and self.is_restricted)
        there = not any(self.notes[one].is_erased or self.notes[one].is_erasing for one in ids)
        return there and not self.is_denied and purpose not in self.objected and (not hit or purpose in OWN_PURPOSES)

    def deny(self) -> bool:
        if self.is_denied:
            return False
        self.is_denied, self.is_whole, self.until_ms = True, False, 0
        self.breach, self.risk, self.told = "opened", "", set()
        for note in self.notes.values():
            note.is_named, note.kept_until_ms = False, 0
        return True

    def object(self, purpose: str) -> bool:
        if not self.is_denied:
            self.objected.add(purpose)
        return not self.is_denied

    def assess(self, risk: str) -> bool:
        rising = ["", "none", "risk", "high"]
        if self.breach not in {"opened", "assessed"} or rising.index(risk) < rising.index(self.risk):
            return False
        self.breach, self.risk = "assessed", risk
        return True

    def notify(self, recipient: str) -> bool:
        if self.breach != "assessed" or recipient in self.told:
            return False
        self.told.add(recipient)
        return True

    def close(self, outcome: str) -> bool:
        needed = {"none": set(), "risk": {"authority"}, "high": {"authority", "subjects"}}.get(self.risk, set())
        is_left = outcome == "erased" and not all(note.is_erased or note.is_erasing for note in self.notes.values())
        if self.breach != "assessed" or not needed <= self.told or is_left:
            return False
        self.breach, self.is_denied = "closed", outcome == "erased"
        return True

    def order(self, ids: list[bytes]) -> bool:
        can = self.breach == "assessed" or (self.breach == "closed" and self.is_denied)
        if not ids or not can or any(self.notes[one].is_erased or self.notes[one].is_erasing for one in ids):
            return False
        for one in ids:
            self.notes[one].is_erasing = True
        return True

    def expire(self, ids: list[bytes], now_ms: int) -> bool:
        if any(self.notes[one].expires_ms > now_ms or self.notes[one].kept_until_ms > now_ms for one in ids):
            return False
        for one in ids:
            self.notes[one].is_erased = True
        return True


PICKED = st.lists(st.integers(0, RECORDS_COUNT - 1), unique=True, max_size=RECORDS_COUNT)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("restrict"), PICKED, st.sampled_from(sorted(GROUNDS))),
        st.tuples(st.just("restrict"), PICKED, st.sampled_from(KEEPING_GROUNDS)),
        st.tuples(st.just("lift"), PICKED),
        st.tuples(st.just("request"), PICKED, st.sampled_from(["research", "own-access"])),
        st.tuples(st.just("expire"), st.lists(st.integers(0, RECORDS_COUNT - 1), unique=True, min_size=1)),
        st.tuples(st.just("wait"), st.sampled_from([DAY_MS, 11 * DAY_MS, 31 * DAY_MS, KEEP_MS - 5 * DAY_MS, KEEP_MS])),
        st.tuples(st.just("object"), st.sampled_from(["research", "care"])),
        st.tuples(st.just("deny")),
        st.tuples(st.just("assess"), st.sampled_from(["none", "risk", "high"])),
        st.tuples(st.just("notify"), st.sampled_from(["authority", "subjects"])),
        st.tuples(st.just("order"), PICKED),
        st.tuples(st.just("close"), st.sampled_from(["erased", "released"])),
    ),
    min_size=3,
    max_size=14,
)


class Play:
    """A hospital and the oracle beside it."""

    def __init__(self) -> None:
        self.hospital, self.oracle = Hospital(), Oracle()
        self.visit = self.hospital.open_visit(self.hospital.enrol("anna"))
        self.officer = self.hospital.enrol("officer", "officer").identity
        self.breach_id = bytes(32)
        for number in range(RECORDS_COUNT):
            expires_ms = self.hospital.time_ms + (10 + 10 * number) * DAY_MS
            record_id = self.hospital.record(self.visit, expires_at_ms=expires_ms)
            self.oracle.record(record_id, expires_ms)

    def ids(self, numbers: list[int]) -> list[bytes]:
        return [self.visit.records[number] for number in numbers]

    def step(self, kind: str, *rest: Any) -> None:
        hospital, oracle, key = self.hospital, self.oracle, self.visit.key
        now_ms = hospital.time_ms + 100  # the time of the block that will hold it
        if kind == "wait":
            hospital.time_ms += rest[0]
            return
        if kind == "restrict":
            expected = oracle.restrict(self.ids(rest[0]), rest[1], now_ms)
            receipt = hospital.send(key, "rights", "restrict", self.ids(rest[0]), rest[1])
        elif kind == "lift":
            expected = oracle.lift(self.ids(rest[0]))
            receipt = hospital.send(key, "rights", "lift", self.ids(rest[0]))
        elif kind == "request":
            expected = oracle.request(self.ids(rest[0]), rest[1])
            receipt = hospital.send(key, "access", "request", self.ids(rest[0]), rest[1])
        elif kind == "expire":
            expected = oracle.expire(self.ids(rest[0]), now_ms)
            receipt = hospital.send(hospital.custodians[0], "erasure", "expired", self.ids(rest[0]), bytes(32))
        elif kind == "object":
            expected = oracle.object(rest[0])
            receipt = hospital.send(key, "rights", "object_to_release", [rest[0]])
        elif kind == "order":
            expected = oracle.order(self.ids(rest[0]))
            receipt = hospital.send(self.officer, "rights", "order_erasure", self.breach_id, self.ids(rest[0]))
        elif kind == "deny":
            expected = oracle.deny()
            receipt = hospital.send(key, "rights", "wrong_person")
            self.breach_id = receipt.txid if receipt.ok else self.breach_id
        else:
            arguments = {"assess": ["matched-wrongly"], "notify": ["facts-came-late"], "close": ["matched-wrongly"]}
            expected = getattr(oracle, kind)(rest[0])
            receipt = hospital.send(self.officer, "rights", kind, self.breach_id, rest[0], *arguments[kind])
        assert receipt.ok == expected, (kind, rest, receipt.code)

    def check(self) -> None:
        hospital, oracle = self.hospital, self.oracle
        row = hospital.view("rights", "restriction", self.visit.owner)
        assert (row is not None) == oracle.is_restricted
        assert (hospital.value("rights", b"quarantine/" + self.visit.owner) is not None) == oracle.is_denied
        for record_id, note in oracle.notes.items():
            if row is not None and not note.is_erased:
                assert (record_id in row["records"]) == note.is_named
        stranger = hospital.send(key_of("stranger"), "access", "request", [], "own-access")
        assert not stranger.ok


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(STEPS)
def test_the_contract_decides_as_sheets_for_each_record_would(steps: list[Step]) -> None:
    play = Play()
    for step in steps:
        play.step(*step)
        play.check()
