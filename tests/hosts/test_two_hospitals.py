"""The tutorial of two hospitals, typed as it is written, on hosts that share nothing but a network and a stick."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from network.lab.hosts.namespaces import Hosts
from tests.cluster.tutorial_reader import Placeholders, Reader, follow

PLACEHOLDERS = {"BR1-...": r"^(BR1-[A-Z2-7-]+)$", "PROPOSAL": r"Its id is ([0-9a-f]{12});"}
READING_MAX_S = 300


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[Hosts]:
    with Hosts(tmp_path / "hosts", ["hospital", "university", "patient"]) as hosts:
        yield hosts


@pytest.mark.docs
@pytest.mark.timeout(READING_MAX_S)
def test_two_hospitals_found_a_network_and_a_patient_joins_from_elsewhere(hosts: Hosts, tmp_path: Path) -> None:
    stick = tmp_path / "stick"
    stick.mkdir()
    placeholders = Placeholders(PLACEHOLDERS, {"/media/stick": str(stick)})
    readers = {name: Reader(host.home, placeholders, before=host.prefix) for name, host in hosts.hosts.items()}
    hospital, university, _ = readers.values()
    groups = {name: [reader] for name, reader in readers.items()}
    try:
        follow("two-hospitals.md", {**groups, "both": [hospital, university], "everybody": list(readers.values())})
        check = "blockrobot genesis check genesis.json --adopt"
        assert _fingerprint(hospital.shown[check]) == _fingerprint(university.shown[check])
    finally:
        for reader in readers.values():
            reader.close()
    carried = b"".join(path.read_bytes() for path in stick.iterdir())
    for home in (host.home for host in hosts.hosts.values()):
        for secret in (path.read_bytes() for path in home.rglob("*.key")):
            assert secret not in carried
            assert secret.hex().encode() not in carried
            elsewhere = [other.home for other in hosts.hosts.values() if other.home != home]
            assert not any(secret in path.read_bytes() for place in elsewhere for path in place.rglob("*.key"))


def _fingerprint(written: str) -> str:
    return next(line for line in written.splitlines() if line.startswith("Fingerprint: "))
