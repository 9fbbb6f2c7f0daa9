"""Governance, whatever organisations and producers do: the schedule stays one that a chain can live on."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from consensus.chain.epoch_settings import ChainSettings, check_settings
from consensus.chain.genesis import prove_possession
from consensus.chain.schedule import Schedule
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.limits import PRODUCERS_MAX_COUNT
from tests.unit.contracts.system.consortium import (
    Consortium,
    admin_of,
    key_of,
    node_fields,
    organisation_fields,
    producer_of,
)

NODES = [f"node-{number:02d}" for number in range(1, 8)]
ORGANISATIONS = ["org-01", "org-02", "org-03", "org-04"]
FAULTS_OF_THE_MACHINE = {
    "TYPE_ERROR",
    "KEY_ERROR",
    "INDEX_ERROR",
    "VALUE_ERROR",
    "NAME_UNSET",
    "OUT_OF_GAS",
    "REENTRANT",
}

Action = tuple[str, str, str, int]
VERBS = (
    "propose approve withdraw remove ready accuse add_node remove_node move_node rekey add_org remove_org second second "
    "base_timeout_ms max_producers wait"
)
actions = st.tuples(
    st.sampled_from(VERBS.split()),
    st.sampled_from(ORGANISATIONS),
    st.sampled_from(NODES),
    st.integers(min_value=0, max_value=30),
)


class Story:
    """Turns actions into transactions; knows the present key of each node and the proposals so far."""

    def __init__(self) -> None:
        self.chain = Consortium(organisations=2, nodes=4)
        self.keys = {name: producer_of(name) for name in NODES}
        self.proposals: list[tuple[str, bytes]] = []

    def transaction(self, action: Action) -> Transaction:
        verb, organisation, node, number = action
        sign, admin, key = self.chain.sign, admin_of(organisation), self.keys[node]
        if verb in {"propose", "approve", "withdraw", "remove"}:
            return sign(admin, "producers", verb, key.public_key)
        if verb == "ready":
            return sign(key, "producers", "ready", self.chain.height, bytes(32))
        if verb == "accuse":
            accuser = producer_of(NODES[number % len(NODES)])
            return sign(accuser, "producers", "accuse", *self.chain.evidence(key, round_number=number))
        if verb == "second" and self.proposals:
            contract, proposal_id = self.proposals[number % len(self.proposals)]
            return sign(admin, contract, "approve", proposal_id)
        if verb in {"base_timeout_ms", "max_producers"}:
            value = number if verb == "max_producers" else 20 * number
            return sign(admin, "settings", "propose", verb, value)
        return sign(admin, "membership", "propose", *self._change(verb, organisation, node, number))

    def _change(self, verb: str, organisation: str, node: str, number: int) -> list[Any]:
        if verb == "add_node":
            return ["add_node", node_fields(node, organisation)]
        if verb == "move_node":
            url = f"https://{node}.example:{number + 1}"
            return ["move_node", {"name": node, "host": f"{node}.example", "p2p_port": number + 1, "api_url": url}]
        if verb == "remove_node":
            return ["remove_node", {"name": node}]
        if verb == "add_org":
            return ["add_org", organisation_fields(organisation)]
        if verb == "rekey":
            new = key_of(f"{node}/{number}")
            proof = prove_possession(new, node)
            return ["rekey_producer", {"node": node, "producer_key": new.public_key, "producer_possession": proof}]
        return ["remove_org", {"name": organisation}]

    def block(self, block: list[Action]) -> None:
        signed = [self.transaction(action) for action in block if action[0] != "wait"]
        self.chain.time_ms += 300_000 * (len(block) - len(signed))
        receipts = self.chain.block(signed)
        for transaction, receipt in zip(signed, receipts, strict=True):
            assert receipt.code not in FAULTS_OF_THE_MACHINE, (receipt.code, receipt.message, transaction.body.entry)
            if receipt.ok and transaction.body.entry == "propose" and transaction.body.contract != "producers":
                self.proposals.append((transaction.body.contract, receipt.txid))
        for name in NODES:
            entry = self.chain.value("membership", b"node/" + name.encode())
            if entry is not None and entry["producer_key"] != self.keys[name].public_key:
                found = [key_of(f"{name}/{number}") for number in range(31)]
                self.keys[name] = next(key for key in found if key.public_key == entry["producer_key"])


@given(st.lists(st.lists(actions, min_size=1, max_size=6), min_size=1, max_size=12))
def test_the_schedule_is_always_one_to_live_on(blocks: list[list[Action]]) -> None:
    story = Story()
    for block in blocks:
        before = story.chain.epoch
        story.block(block)
        after = story.chain.epoch
        changed = (before.producers, before.leaderless, before.settings) != (
            after.producers,
            after.leaderless,
            after.settings,
        )
        assert after.number - before.number in ((1,) if changed else (0, 1))
        assert 1 <= len(after.producers) <= PRODUCERS_MAX_COUNT
        assert len(set(after.producers)) == len(after.producers)
        assert len(after.leaderless) < len(after.producers)
        assert list(after.leaderless) == sorted(set(after.leaderless))
        check_settings(after.settings)
        Schedule.of(after)
        for key in after.producers:
            entry = story.chain.candidate(key)
            assert entry["status"] in {"producing", "suspended"}
            assert set(entry["votes"]) | set(entry["removals"]) <= set(story.chain.active())
            node = story.chain.value("membership", b"node/" + entry["name"].encode())
            assert (node["status"], node["producer_key"]) == ("active", key)
        assert story.chain.active()


@given(
    st.sampled_from([name for name in ChainSettings.__struct_fields__ if name != "production"]),
    st.integers(min_value=-2, max_value=1000),
)
def test_a_number_is_refused_where_the_genesis_file_refuses_it(name: str, value: int) -> None:
    chain = Consortium(organisations=1, nodes=1)
    receipt = chain.send(admin_of("org-01"), "settings", "propose", name, value)
    fields = {field: getattr(ChainSettings(), field) for field in ChainSettings.__struct_fields__}
    try:
        check_settings(ChainSettings(**{**fields, name: value}))
    except BlockRobotError:
        assert receipt.code == "VALUE_WRONG"
    else:
        assert receipt.ok


@given(
    st.one_of(st.text(max_size=12), st.builds(lambda text: f"interval:{text}", st.text("0123456789 -+", max_size=9)))
)
def test_a_production_is_refused_where_the_genesis_file_refuses_it(text: str) -> None:
    chain = Consortium(organisations=1, nodes=1)
    receipt = chain.send(admin_of("org-01"), "settings", "propose", "production", text)
    try:
        check_settings(ChainSettings(production=text))
    except BlockRobotError:
        assert receipt.code == "VALUE_WRONG"
    else:
        assert receipt.ok == (text != "manual")
