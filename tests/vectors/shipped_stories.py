"""Stories of a hospital and of a consortium, written down call by call, as vectors of the contracts that ship."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import contracts.vm
from contracts import vectors
from contracts.execution import executor, genesis, views
from contracts.lifecycle.registry import SHIPPED_CONTRACTS
from tests.unit.contracts.privacy.hospital import Hospital, Person, key_of
from tests.unit.contracts.system.consortium import Consortium, admin_of, node_fields, organisation_fields, producer_of
from tests.unit.contracts.system.deploying import VISITORS, deployment, upload


@contextmanager
def recording(calls: list[dict[str, Any]]) -> Iterator[None]:
    """Write down every call of the machine, in the notation of vectors."""

    def invoke(active: Any, contract: str, entry: str, args: list[Any], **more: Any) -> Any:
        context = more["context"]
        calls.append(
            {
                "call": f"{contract}.{entry}",
                "args": vectors.to_json(args),
                "mode": more["mode"],
                "gas_limit": more["gas_limit"],
                **{
                    name: vectors.to_json(getattr(context, name))
                    for name in ("caller", "height", "time_ms", "txid", "chain_id")
                },
            }
        )
        outcome = contracts.vm.invoke(active, contract, entry, args, **more)
        calls[-1]["outcome"] = {"code": outcome.code, "gas": outcome.gas_used}
        return outcome

    modules = (executor, genesis, views)
    for module in modules:
        module.invoke = invoke  # type: ignore[attr-defined]
    try:
        yield
    finally:
        for module in modules:
            module.invoke = contracts.vm.invoke  # type: ignore[attr-defined]


def consent_story(hospital: Hospital, anna: Person, ben: Person) -> None:
    for arguments in (
        (["care", "research"], ["depth", "rgb"], 0, 0, 0),
        (["research"], ["audio"], 0, 1_700_010_000_000, hospital.height + 5),
        (["research"], ["x-ray"], 0, 0, 0),
        (["research"], ["audio"], 1, 0, 0),
    ):
        hospital.send(anna.identity, "consent", "give", anna.handle, *arguments, hospital.height)
    hospital.send(ben.identity, "consent", "give", anna.handle, ["care"], ["depth"], 0, 0, 0, hospital.height)
    hospital.send(anna.identity, "consent", "give", anna.handle, ["care"], ["depth"], 0, 0, 0, 0)
    hospital.must(anna.identity, "consent", "refuse", anna.handle, ["demo"], [])
    hospital.view("consent", "allowed", anna.handle, "care", "rgb")
    hospital.view("consent", "choices", anna.handle)
    hospital.must(anna.identity, "consent", "withdraw", anna.handle, [], ["rgb"])
    hospital.must(anna.identity, "consent", "withdraw", anna.handle, [], [])
    hospital.send(anna.identity, "consent", "withdraw", anna.handle, [], [])
    hospital.send(anna.identity, "consent", "end", anna.handle)
    hospital.view("consent", "allowed", anna.handle, "care", "rgb")


def rights_story() -> None:
    hospital = Hospital()
    anna, ben = hospital.enrol("anna"), hospital.enrol("ben")
    officer = hospital.enrol("officer", "officer").identity
    visit, other = hospital.open_visit(anna), hospital.open_visit(ben)
    for _ in range(3):
        hospital.record(visit)
    first = visit.records[:1]
    hospital.must(visit.key, "rights", "restrict", first, "legal-claim")
    hospital.send(visit.key, "rights", "restrict", [], "accuracy")
    hospital.send(other.key, "rights", "restrict", first, "accuracy")
    hospital.send(visit.key, "access", "request", first, "research")
    hospital.must(visit.key, "access", "request", first, "own-access")
    hospital.view("rights", "restriction", visit.owner)
    hospital.must(visit.key, "rights", "restrict", [], "unlawful")
    hospital.send(visit.key, "rights", "lift", first)
    hospital.must(visit.key, "rights", "lift", [])
    hospital.must(anna.identity, "rights", "object_to", anna.handle, ["research"])
    hospital.send(ben.identity, "rights", "object_to", anna.handle, ["research"])
    hospital.view("consent", "choices", anna.handle)
    hospital.must(visit.key, "rights", "object_to_release", ["research"])
    hospital.send(visit.key, "access", "request", first, "research")
    hospital.must(visit.key, "rights", "rectify", first, "attribution", bytes(32))
    hospital.must(visit.key, "rights", "rectify", [], "metadata", bytes(31) + b"1")
    hospital.view("rights", "corrections", visit.owner, 0, 10)
    denied = hospital.must(visit.key, "rights", "wrong_person").txid
    hospital.send(visit.key, "access", "request", first, "own-access")
    hospital.send(visit.key, "erasure", "request", first, [])
    hospital.send(officer, "rights", "close", denied, "released", "owner-confirmed")
    hospital.must(officer, "rights", "assess", denied, "high", "released-before")
    hospital.must(officer, "rights", "order_erasure", denied, visit.records)
    hospital.time_ms += 73 * 3600 * 1000
    hospital.send(officer, "rights", "notify", denied, "authority", "")
    hospital.must(officer, "rights", "notify", denied, "authority", "facts-came-late")
    hospital.send(officer, "rights", "close", denied, "erased", "matched-wrongly")
    hospital.must(officer, "rights", "notify", denied, "subjects", "")
    hospital.must(officer, "rights", "close", denied, "erased", "matched-wrongly")
    hospital.view("rights", "breaches", 0, 10)
    hospital.view("rights", "breach", denied)
    hospital.view("audit", "events", visit.owner, 0, 50)


def sharing_story() -> None:
    hospital = Hospital()
    nurse = hospital.enrol("nurse", "staff")
    visit, other = hospital.open_visit(hospital.enrol("anna")), hospital.open_visit(hospital.enrol("ben"))
    for _ in range(3):
        hospital.record(visit)
    grantee, ephemeral = key_of("grantee"), key_of("ephemeral").public_key
    until_ms = visit.bucket_ms + 3_600_000
    words = [grantee.public_key, ephemeral, 7, bytes(32), "care", until_ms]
    hospital.send(other.key, "access", "grant", visit.records[:2], *words)
    hospital.send(visit.key, "access", "grant", visit.records[:2], *words[:-1], until_ms + 1)
    hospital.send(visit.key, "access", "grant", visit.records[:2], nurse.identity.public_key, *words[1:])
    shared = hospital.must(visit.key, "access", "grant", visit.records[:2], *words).txid
    hospital.send(visit.key, "access", "grant", visit.records[:1], *words)
    hospital.send(nurse.identity, "access", "request_granted", shared, visit.records[:1], "care")
    hospital.send(grantee, "access", "request_granted", shared, visit.records[2:], "care")
    asked = hospital.must(grantee, "access", "request_granted", shared, visit.records[:1], "care").txid
    hospital.must(hospital.custodians[0], "access", "released", asked, visit.records[:1])
    hospital.must(visit.key, "rights", "restrict", visit.records[:1], "accuracy")
    hospital.send(grantee, "access", "request_granted", shared, visit.records[:2], "care")
    hospital.must(visit.key, "erasure", "request", visit.records[1:2], [])
    hospital.must(grantee, "access", "noticed", shared, visit.records[1:2])
    hospital.send(grantee, "access", "noticed", shared, visit.records[1:2])
    hospital.send(other.key, "access", "revoke", shared)
    hospital.must(visit.key, "access", "revoke", shared)
    hospital.send(grantee, "access", "request_granted", shared, visit.records[:1], "care")
    hospital.view("access", "grants", 0, 10)
    hospital.view("access", "grant_of", shared)
    hospital.view("access", "get", asked)
    hospital.view("audit", "events", visit.owner, 0, 50)


def officers_story() -> None:
    hospital = Hospital()
    visit, other = hospital.open_visit(hospital.enrol("anna")), hospital.open_visit(hospital.enrol("ben"))
    for recorded in (visit, visit, other):
        hospital.record(recorded)
    first, second = (hospital.enrol(name, "officer").identity for name in ("first", "second"))
    span = [visit.robot.identity.public_key, visit.bucket_ms, visit.bucket_ms + 300_000]
    hospital.send(first, "officers", "propose", *span, "key-lost", 1)
    hospital.time_ms = span[2]
    hospital.send(hospital.robot.identity, "officers", "propose", *span, "key-lost", 1)
    hospital.send(first, "officers", "propose", *span, "so-it-seems", 1)
    agreed = hospital.must(first, "officers", "propose", *span, "key-lost", 1).txid
    hospital.send(first, "officers", "approve", agreed)
    hospital.send(first, "officers", "erase", agreed, visit.owner, visit.records)
    hospital.must(second, "officers", "approve", agreed)
    hospital.must(visit.key, "rights", "restrict", visit.records[:1], "legal-claim")
    hospital.send(second, "officers", "erase", agreed, visit.owner, visit.records)
    hospital.must(second, "officers", "erase", agreed, visit.owner, visit.records[1:])
    hospital.send(second, "officers", "erase", agreed, other.owner, other.records)
    hospital.must(first, "officers", "stop", agreed)
    robot, frames = hospital.robot.identity.public_key, [bytes([number]) * 32 for number in range(3)]
    hospital.send(hospital.robot.identity, "records", "approve_empty_frames", robot, frames)
    hospital.must(first, "records", "approve_empty_frames", robot, frames)
    hospital.must(hospital.admin, "records", "withdraw_empty_frames", robot, frames[:1])
    hospital.send(second, "records", "withdraw_empty_frames", robot, frames[:1])
    hospital.view("records", "empty_frames", robot)
    hospital.view("officers", "proposals", 0, 10)
    hospital.view("officers", "proposal", agreed)
    hospital.view("records", "of_visit", visit.owner)
    hospital.view("audit", "events", visit.owner, 0, 50)


def mandates_story() -> None:
    hospital = Hospital()
    child, mother = hospital.enrol("child"), hospital.enrol("mother")
    first, second = (hospital.enrol(name, "officer").identity for name in ("first", "second"))
    until_ms = hospital.bucket() + 30 * 24 * 3_600_000
    proposal = [child.handle, mother.handle, bytes(32), ["consent"], until_ms]
    hospital.send(mother.identity, "mandates", "propose", *proposal)
    hospital.send(first, "mandates", "propose", *proposal[:-1], until_ms + 1)
    given = hospital.must(first, "mandates", "propose", *proposal).txid
    hospital.send(first, "mandates", "approve", given)
    hospital.must(second, "mandates", "approve", given)
    hospital.send(child.identity, "mandates", "accept", given)
    hospital.must(mother.identity, "mandates", "accept", given)
    for purpose, end_ms in (("research", 0), ("research", until_ms), ("demo", until_ms)):
        word = [child.handle, [purpose], ["depth"], 0, end_ms, 0, hospital.height]
        hospital.send(mother.identity, "consent", "give", *word)
    hospital.must(child.identity, "consent", "refuse", child.handle, ["demo"], [])
    hospital.send(
        mother.identity, "consent", "give", child.handle, ["demo"], ["depth"], 0, until_ms, 0, hospital.height
    )
    hospital.must(mother.identity, "rights", "object_to", child.handle, ["care"])
    hospital.send(first, "mandates", "close", given)
    hospital.must(child.identity, "mandates", "end", given)
    hospital.send(mother.identity, "consent", "withdraw", child.handle, [], [])
    hospital.view("mandates", "mandate", given)
    hospital.view("mandates", "mandates", 0, 10)
    hospital.view("mandates", "trail", given, 0, 10)
    hospital.view("consent", "choices", child.handle)


def hospital_story() -> None:
    hospital = Hospital()
    anna, ben = hospital.enrol("anna"), hospital.enrol("ben", "staff")
    hospital.send(anna.identity, "identity", "register", *hospital.register_arguments(anna, hospital.card("anna")))
    forged = hospital.register_arguments(ben, hospital.card("ben"))
    hospital.send(ben.identity, "identity", "register", *forged[:-2], bytes(65), forged[-1])
    hospital.must(anna.identity, "identity", "authenticate", anna.handle)
    hospital.send(ben.identity, "identity", "authenticate", anna.handle)
    consent_story(hospital, anna, ben)
    visit = hospital.open_visit(anna)
    for _ in range(3):
        hospital.record(visit)
    hospital.send(hospital.robot.identity, "records", "record", *hospital.record_arguments(visit, 0))
    hospital.send(ben.identity, "records", "record", *hospital.record_arguments(visit, 9))
    hospital.send(hospital.robot.identity, "records", "record", b"short")
    hospital.view("records", "get", visit.records[0])
    hospital.view("records", "of_visit", visit.owner)
    hospital.view("records", "announcements", 0, 10)
    asked = hospital.must(visit.key, "access", "request", visit.records[:1], "care")
    hospital.must(hospital.custodians[0], "access", "released", asked.txid, visit.records[:1])
    hospital.send(hospital.custodians[1], "access", "refused", asked.txid, "NOT_HELD")
    hospital.send(ben.identity, "access", "request", visit.records[:1], "care")
    hospital.send(visit.key, "access", "verdict", [[visit.records[0], "authentic", []]])
    hospital.must(visit.key, "access", "verdict", [[name, "verified", []] for name in visit.records[:2]])
    hospital.must(hospital.robot.identity, "records", "close_visit", visit.owner, 3)
    erased = hospital.must(visit.key, "erasure", "request", visit.records[:2], [])
    hospital.receipts_of_all(erased.txid)
    hospital.view("erasure", "get", erased.txid)
    hospital.view("audit", "events", visit.owner, 0, 50)
    hospital.view("identity", "member", anna.identity.public_key)
    hospital.send(anna.identity, "identity", "leave", anna.handle)
    hospital.send(anna.identity, "identity", "authenticate", anna.handle)


def consortium_story() -> None:
    chain = Consortium()
    admin = admin_of("org-01")
    chain.agree("add_org", organisation_fields("org-04"))
    chain.agree("add_node", node_fields("node-05", "org-01"))
    chain.send(admin, "membership", "propose", "add_node", {"name": 5})
    chain.send(producer_of("node-01"), "membership", "propose", "add_org", organisation_fields("org-05"))
    chain.vote_in(producer_of("node-05").public_key)
    chain.ready("node-05")
    chain.agree_setting("base_timeout_ms", 800)
    chain.send(admin, "settings", "propose", "base_timeout_ms", 1)
    accused = producer_of("node-02")
    chain.send(admin, "producers", "accuse", *chain.evidence(accused))
    for contract, view in (("producers", "current"), ("producers", "candidates"), ("membership", "list_nodes"),
                           ("membership", "proposals"), ("settings", "in_force"), ("settings", "names")):  # fmt: skip
        chain.view(contract, view)
    upload(chain, admin, VISITORS)
    proposed = chain.must(admin, "lifecycle", "propose", "deploy", deployment("visitors", VISITORS))
    chain.send(admin, "lifecycle", "approve", proposed.txid)
    source = "@export\ndef f():\n    return 1 1\n"
    upload(chain, admin_of("org-02"), source)
    chain.send(admin_of("org-02"), "lifecycle", "propose", "deploy", deployment("broken", source))
    chain.view("lifecycle", "contracts")
    chain.view("lifecycle", "uploads", "org-01")


def record(story: Callable[[], None]) -> dict[str, Any]:
    """Return a story as a document; what its calls came to is what vectors find, or the story is no vector."""
    calls: list[dict[str, Any]] = []
    with recording(calls):
        story()
    first = max(place for place, call in enumerate(calls) if call["call"] == "lifecycle.genesis")
    document = {
        "about": (story.__name__.replace("_", " ") + ", by the contracts that ship.").capitalize(),
        "contracts": dict.fromkeys(SHIPPED_CONTRACTS),
        "calls": calls[first:],
    }
    for told, found in zip(document["calls"], vectors.play(document)["calls"], strict=True):
        expected = (told["outcome"]["code"], told["outcome"]["gas"])
        assert expected == (found["outcome"]["code"], found["outcome"]["gas"]), (told, found["outcome"])
    return document


def documents() -> dict[str, dict[str, Any]]:
    """Return the documents of the shipped contracts by file name."""
    stories = {
        "hospital.json": hospital_story,
        "rights.json": rights_story,
        "sharing.json": sharing_story,
        "officers.json": officers_story,
        "mandates.json": mandates_story,
        "consortium.json": consortium_story,
    }
    return {name: record(story) for name, story in stories.items()}
