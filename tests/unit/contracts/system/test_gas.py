"""What governance costs: every entry stays within a call's gas at the very limits of a network."""

from __future__ import annotations

import pytest

from consensus.chain.genesis import prove_possession
from consensus.limits import CALL_GAS_MAX
from tests.unit.contracts.system.consortium import (
    CERTIFICATE,
    Consortium,
    admin_of,
    key_of,
    node_fields,
    organisation_fields,
    producer_of,
)

OPEN_COUNT = 112
LONG_URL = "https://" + "u." * 123 + "u"
LONG_CERTIFICATE = CERTIFICATE + "A" * (4096 - len(CERTIFICATE))


def _keys(name: str) -> dict[str, list[bytes]]:
    """As many admins and registrars as an organisation may have."""
    kinds = ("admin", "registrar")
    return {f"{kind}s": [key_of(f"{name}/{kind}/{number}").public_key for number in range(16)] for kind in kinds}


@pytest.fixture
def chain() -> Consortium:
    """A network at its limits, but for one organisation and one node.

    21 producers and as many candidates, all with every vote; one organisation with 24 nodes, 21 of them candidates and
    all of them custodians; three suspended; 112 open proposals with long certificates; 32 closed ones.
    """
    chain = Consortium(organisations=31, nodes=21)
    admin = admin_of("org-01")
    for number in range(32):
        fields = {"organisation": "org-01", "serial": number.to_bytes(20, "big")}
        chain.must(admin, "membership", "propose", "revoke_certificate", fields)
    for number in range(22, 64):
        owner = "org-02" if number < 45 else "org-03"
        chain.agree("add_node", node_fields(f"node-{number}", owner, custodian=True))
    for number in range(22, 43):
        key = producer_of(f"node-{number}").public_key
        chain.must(admin, "producers", "propose", key)
        for name in chain.organisations[1:]:
            chain.must(admin_of(name), "producers", "approve", key)
        chain.ready(f"node-{number}")
    for number in (3, 4, 5):
        chain.must(producer_of("node-01"), "producers", "accuse", *chain.evidence(producer_of(f"node-{number:02d}")))
    for place in range(OPEN_COUNT):
        fields = {**organisation_fields(f"new-{place}"), "ca_certificate": LONG_CERTIFICATE}
        chain.must(admin_of(f"org-{place // 4 + 4:02d}"), "membership", "propose", "add_org", fields)
    assert len(chain.value("membership", b"nodes-of/org-02")) == 24
    assert len(chain.view("membership", "list_nodes")) == 63
    return chain


def _spent(chain: Consortium, kind: str, arguments: dict[str, object]) -> list[int]:
    first, *others = chain.majority()
    proposed = chain.must(admin_of(first), "membership", "propose", kind, arguments)
    approved = [chain.must(admin_of(name), "membership", "approve", proposed.txid) for name in others]
    return [receipt.gas_used for receipt in (proposed, *approved)]


def test_no_entry_comes_near_the_limit_of_a_call(chain: Consortium) -> None:
    assert len(chain.view("membership", "proposals")) == OPEN_COUNT
    assert len(chain.view("producers", "candidates")) == 42
    spent: dict[str, int] = {}
    new = key_of("new")
    rekeyed = {
        "node": "node-06",
        "producer_key": new.public_key,
        "producer_possession": prove_possession(new, "node-06"),
    }
    for kind, arguments in (
        ("add_org", {**organisation_fields("org-32"), **_keys("org-32"), "ca_certificate": LONG_CERTIFICATE}),
        ("replace_keys", {"organisation": "org-31", **_keys("org-31")}),
        ("replace_ca", {"organisation": "org-03", "ca_certificate": LONG_CERTIFICATE}),
        ("add_node", node_fields("node-99", "org-04", custodian=True)),
        ("remove_node", {"name": "node-07"}),
        ("rekey_producer", rekeyed),
        ("move_node", {"name": "node-08", "host": "h." * 126 + "h", "p2p_port": 65535, "api_url": LONG_URL}),
        ("revoke_certificate", {"organisation": "org-02", "serial": bytes(20)}),
        ("remove_org", {"name": "org-32"}),
        ("remove_org", {"name": "org-02"}),
    ):
        spent[kind] = max(_spent(chain, kind, arguments))
    key = producer_of("node-08").public_key
    admin = admin_of("org-01")
    calls = [
        ("producers", "withdraw", admin, [key]),
        ("producers", "approve", admin, [key]),
        ("producers", "remove", admin_of("org-08"), [key]),
        ("producers", "propose", admin, [key]),
        ("producers", "accuse", producer_of("node-01"), chain.evidence(producer_of("node-09"))),
        ("producers", "ready", producer_of("node-09"), [chain.height, bytes(32)]),
        ("settings", "propose", admin, ["production", "interval:100"]),
    ]
    for contract, entry, sender, arguments in calls:
        spent[f"{contract}.{entry}"] = chain.must(sender, contract, entry, *arguments).gas_used
    spent["settings.approve"] = chain.agree_setting("max_producers", 20).gas_used
    with_many_keys_or_nodes = [spent.pop(kind) for kind in ("add_org", "replace_keys", "remove_org")]
    assert max(spent.values()) < CALL_GAS_MAX // 3, spent
    assert max(with_many_keys_or_nodes) < CALL_GAS_MAX * 2 // 3, with_many_keys_or_nodes


def test_old_proposals_are_cleared_away_within_the_limit(chain: Consortium) -> None:
    chain.time_ms += 8 * 24 * 3600 * 1000
    receipts = [chain.must(admin_of("org-01"), "settings", "propose", "heartbeat_ms", 1000 + n) for n in range(4)]
    assert max(receipt.gas_used for receipt in receipts) < CALL_GAS_MAX // 2
    assert len(chain.view("membership", "proposals")) == OPEN_COUNT - 8 + 4
