"""However often visits are transferred, and by whomever: of each exactly one key decides, the one put in place last."""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from consensus.primitives.keys import PrivateKey
from consensus.state.records import decided_root
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit

PERSON = Person("anna")
VISITS_COUNT = 2
STEPS = st.lists(st.tuples(st.integers(0, VISITS_COUNT - 1), st.integers(0, 12)), max_size=10)


@dataclass
class Chain:
    """A visit and every key that it ever had, the last one being in force."""

    visit: Visit
    keys: list[PrivateKey] = field(default_factory=list)


def check(hospital: Hospital, chains: list[Chain]) -> None:
    for chain in chains:
        root = chain.visit.owner
        assert hospital.view("records", "current_of", root) == chain.keys[-1].public_key
        decides = [key for key in chain.keys if decided_root(hospital.state, key.public_key) is not None]
        assert decides == [chain.keys[-1]]
        assert decided_root(hospital.state, chain.keys[-1].public_key) == root
        for key in chain.keys:
            receipt = hospital.send(key, "access", "request", chain.visit.records, "own-access")
            assert receipt.code == ("OK" if key is chain.keys[-1] else "VISIT_TRANSFERRED")


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(steps=STEPS)
def test_of_each_visit_exactly_the_last_key_decides(steps: list[tuple[int, int]]) -> None:
    hospital = Hospital()
    chains = [Chain(visit, [visit.key]) for visit in (hospital.open_visit(PERSON, n) for n in range(VISITS_COUNT))]
    for chain in chains:
        hospital.record(chain.visit)
    for number, (place, signer) in enumerate(steps):
        chain = chains[place]
        key = chain.keys[signer % len(chain.keys)]
        new, arguments = hospital.transfer_arguments(chain.visit.owner, PERSON, 100 + number)
        receipt = hospital.send(key, "records", "transfer", *arguments)
        assert receipt.ok == (key is chain.keys[-1]), receipt.code
        if receipt.ok:
            chain.keys.append(new)
    check(hospital, chains)
