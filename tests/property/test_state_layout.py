"""The layout of the state: whatever happened on the chain, every key is of one kind, every row reads, queries say as views.

Histories are played by everybody of the scenes in which each entry of the shipped contracts is tried, in any order.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.state import access, audit, consent, identity, mandates, membership, producers, records, rights
from consensus.state.keys import RECORD_ID_BYTES, Prefix, Row, Rows, to_value
from consensus.state.layout import LAYOUT, owners_of
from contracts.lifecycle.registry import read_source
from tests.unit.contracts.privacy import callers as of_privacy
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, key_of
from tests.unit.contracts.system import callers as of_system
from tests.unit.contracts.system.consortium import Consortium
from tests.unit.contracts.system.deploying import upgrade

SENSORS = ("audio", "depth", "emotion", "rgb")
STEPS = st.lists(
    st.tuples(st.integers(0, 499), st.integers(0, 49), st.sampled_from((0, 0, 0, 0, DAY_MS, 40 * DAY_MS))), max_size=14
)
histories = settings(suppress_health_check=[HealthCheck.too_slow])


class World:
    """A scene with everybody in it; `again` puts its chain back to where it began."""

    def __init__(self, is_system: bool) -> None:
        self.scene: Any = of_system.Scene() if is_system else of_privacy.Scene(Hospital())
        self.chain: Any = self.scene.chain if is_system else self.scene.hospital
        rows: list[Any] = of_system.RULES if is_system else of_privacy.RULES
        self.rules = [row for row in rows if row[3]]
        chain = self.chain
        self._first = (copy.deepcopy(chain.state), chain.height, chain.time_ms, chain._salt)

    def again(self) -> None:
        chain = self.chain
        state, chain.height, chain.time_ms, chain._salt = self._first
        chain.state = copy.deepcopy(state)

    def step(self, rule: int, caller: int, later_ms: int) -> None:
        """Somebody who might does something; whether the chain takes it depends on what was before."""
        contract, entry, arguments, allowed = self.rules[rule % len(self.rules)]
        names = sorted(allowed)
        self.chain.time_ms += later_ms
        values = arguments(self.scene)
        self.chain.send(self.scene.everyone[names[caller % len(names)]], contract, entry, *values)

    def rows(self) -> Iterator[tuple[bytes, bytes]]:
        yield from self.chain.state.scan(b"", 1 << 30)


@cache
def world(is_system: bool) -> World:
    return World(is_system)


def check_rows(rows: Iterator[tuple[bytes, bytes]]) -> set[str]:
    """Every key is of one kind, every row reads and is written as it was. Return the kinds that were met."""
    met = set()
    for key, data in rows:
        owners = owners_of(key)
        assert len(owners) == 1, (key, [each.name for each in owners])
        (kind,) = owners
        assert key == (kind.key(*kind.split(key)) if isinstance(kind, Prefix) else kind.flat)
        row = kind.decode(data)
        assert kind.encode(row) == data, kind.name
        assert kind.convert(decode_value(data)) == row
        met.add(kind.name)
    return met


def answer(view: Callable[[], Any]) -> Any:
    """Return what a view says, None where it fails."""
    try:
        return view()
    except BlockRobotError as error:
        if error.code != "CALL_REFUSED":
            raise
        return None


def check_members(chain: Any) -> None:
    state = chain.state
    keys = [key for key, _ in state.scan(identity.MEMBER.flat, 1000)]
    members = [identity.MEMBER.split(key)[0] for key in keys]
    assert members
    for member in [*members, key_of("stranger").public_key]:
        assert identity.active_role(state, member) == chain.view("identity", "role_of", member)
        said = chain.view("identity", "member", member)
        assert identity.is_registered(state, member) == (said is not None and said["status"] == "active")
        assert identity.handle_of(state, member) == (said["handle"] if said else b"")
        assert identity.organisation_of(state, member) == (said["org"] if said else "")
    for key, data in state.scan(identity.HANDLE.flat, 1000):
        row = identity.MEMBER.at(state, identity.HANDLE.decode(data))
        (handle,) = identity.HANDLE.split(key)
        assert identity.member_with(state, handle) == row
        assert identity.handle_from(state, handle[: identity.SHORT_HANDLE_BYTES]) == handle
    assert identity.custodians(state) == chain.view("identity", "custodians")
    for key, _ in state.scan(identity.ADMIN.flat, 1000):
        admin = identity.ADMIN.split(key)[0]
        assert identity.office_of(state, admin) == ("admin", chain.view("identity", "admin_of", admin))


def _is_within(step: consent.StepRow, time_ms: int) -> bool:
    return step.from_ms <= time_ms and not 0 < step.until_ms <= time_ms


def check_choices(chain: Any) -> None:
    state = chain.state
    members = [identity.HANDLE.decode(data) for _, data in state.scan(identity.HANDLE.flat, 1000)]
    for key, data in state.scan(consent.CHOICES.flat, 1000):
        (handle,) = consent.CHOICES.split(key)
        choices = consent.read_choices(decode_value(data))
        for purpose in (*consent.CHOICES.decode(data), "research"):
            for sensor in SENSORS:
                said = chain.view("consent", "allowed", handle, purpose, sensor)
                steps = choices.get((purpose, sensor), ())
                reached = [step for step in steps if step.height <= chain.height]
                held = consent.effective_consent(reached, chain.height)
                assert said == (held is not None and _is_within(held, chain.time_ms))
    for key, _ in state.scan(mandates.OF.flat, 1000):
        (handle,) = mandates.OF.split(key)
        for member in members:
            said = chain.view("mandates", "acting_for", handle, member, "consent")
            found = mandates.acting_for(state, handle, member, "consent", chain.time_ms)
            assert found == (said["mandate_id"] if said else None)


def check_visits(chain: Any, everyone: dict[str, Any]) -> None:
    state = chain.state
    roots = [records.VISIT.split(key)[0] for key, _ in state.scan(records.VISIT.flat, 1000)]
    later = [records.ROOT.split(key)[0] for key, _ in state.scan(records.ROOT.flat, 1000)]
    for key in [*roots, *later, *(each.public_key for each in everyone.values())]:
        assert records.decided_root(state, key) == answer(lambda key=key: chain.view("records", "root_of", key))
    for root in roots:
        assert records.current_owner(state, root) == chain.view("records", "current_of", root)
        said = chain.view("audit", "events", root, 0, 128)
        count = audit.entry_count(state, root)
        found = [audit.ENTRY.decode(state.get(key)) for key in audit.entry_keys(root, count)]
        assert [to_value(row) for row in found[:128]] == said
    for key, data in state.scan(records.RECORD.flat, 1000):
        (record_id,) = records.RECORD.split(key)
        row = records.RECORD.decode(data)
        asked = [[row.owner, record_id, row.expires_at_ms]]
        held = answer(lambda asked=asked: chain.view("rights", "require_not_held", asked)) is None
        assert rights.is_held(state, row.owner, record_id, row.expires_at_ms, chain.time_ms) == held
    for key, _ in state.scan(records.EMPTY_FRAMES.flat, 1000):
        (robot,) = records.EMPTY_FRAMES.split(key)
        said = [frame for frame, *_ in chain.view("records", "empty_frames", robot)]
        assert all(records.is_frame_approved(state, robot, frame) for frame in said)
        assert not records.is_frame_approved(state, robot, b"\xff" * 32)
    for key, data in state.scan(access.GRANT.flat, 1000):
        (grant_id,) = access.GRANT.split(key)
        assert access.grant_of(state, grant_id, access.GRANT.decode(data).grantee, 0) == access.GRANT.decode(data)
        assert access.grant_of(state, grant_id, key_of("stranger").public_key, 0) is None


def check_network(chain: Any) -> None:
    state = chain.state
    assert membership.active_organisations(state) == chain.view("membership", "active_organisations")
    assert membership.active_nodes(state) == chain.view("membership", "list_nodes")
    standing = {key for key, _ in state.scan(producers.CANDIDATE.flat, 1000)}
    own = {producers.CANDIDATE.split(key)[0] for key in standing}
    assert {key for key in own if producers.is_candidate(state, key)} == set(producers.KEYS.read(state) or [])


@pytest.mark.parametrize("is_system", [False, True], ids=["people", "organisations"])
@histories
@given(steps=STEPS)
def test_every_key_is_known_every_row_reads_and_queries_say_as_the_contracts(
    is_system: bool, steps: list[tuple[int, int, int]]
) -> None:
    played = world(is_system)
    played.again()
    for step in steps:
        played.step(*step)
    check_rows(played.rows())
    check_members(played.chain)
    check_choices(played.chain)
    check_visits(played.chain, played.scene.everyone)
    check_network(played.chain)


def test_whatever_the_layout_names_is_written_by_somebody() -> None:
    met: set[str] = set()
    for is_system in (False, True):
        played = world(is_system)
        for number in range(len(played.rules)):
            played.again()
            for caller in range(3):
                played.step(number, caller, 0)
            met |= check_rows(played.rows())
    chain = Consortium()
    chain.agree_setting("robot_day_max_mib", 7)
    upgrade(chain, "audit", read_source("audit") + "\n")
    met |= check_rows(chain.state.scan(b"", 1 << 30))
    assert {kind.name for kind in LAYOUT} - met == set()


def test_a_field_that_a_contract_does_not_write_is_found() -> None:
    """The check of the rows is worth something: it refuses a row whose schema names one field otherwise."""
    played = world(is_system=False)
    played.again()
    found = [data for _, data in played.chain.state.scan(records.RECORD.flat, 1000)]
    renamed = [
        ("keeper" if field.name == "owner" else field.name, field.type)
        for field in msgspec.structs.fields(records.RecordRow)
    ]
    other: Rows[Any] = Prefix(
        "records", "record/", (RECORD_ID_BYTES,), msgspec.defstruct("Other", renamed, bases=(Row,))
    )
    for data in found:
        assert records.RECORD.decode(data).status
        with pytest.raises(BlockRobotError, match="ENCODING_INVALID"):
            other.decode(data)
