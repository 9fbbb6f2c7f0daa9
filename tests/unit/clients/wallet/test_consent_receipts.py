"""Receipts that land in the wallet: signed by both sides, checked against the chain, and no forged one among them."""

from __future__ import annotations

import asyncio
import errno
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner

from clients.bundle.checks import consent_receipts as file
from clients.bundle.checks.chain_proofs import ProvedChain
from clients.bundle.cli import verify
from clients.wallet.commands import consent_commands
from clients.wallet.consent import receipt_fetching as wallet_receipts
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.consent.notice_reading import Notices
from clients.wallet.consent.receipt_fetching import ConsentReceipts, try_fetch_receipt
from clients.wallet.presentation.consent_text import receipt_line
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.rights.consent_receipts import sign_as_controller, sign_as_person
from consensus.rights.notices import Notice
from consensus.state.identity import MEMBER
from network.notices.notice_publishing import demo_notice
from node.custody.coordination.consent_receipts import SignedReceipt
from tests.unit.contracts.privacy.hospital import key_of
from tests.world.notices import NoticeWard


@pytest.fixture
def ward(tmp_path: Path) -> NoticeWard:
    ward = NoticeWard(tmp_path)
    ward.publish(demo_notice())
    return ward


def other_words() -> Notice:
    return msgspec.structs.replace(demo_notice(), obligation="No. Other words.")


async def say(ward: NoticeWard, entry: str = "give", purposes: tuple[str, ...] = ("care",)) -> bytes:
    saying = ConsentClient(ward.wallet)
    if entry == "give":
        return (await saying.give(list(purposes), ["depth"])).txid
    return (await getattr(saying, entry)(list(purposes), [])).txid


def changed(**changes: Any) -> Callable[[SignedReceipt], SignedReceipt]:
    """A node that writes other words into a receipt, and signs them well."""

    def forge(signed: SignedReceipt) -> SignedReceipt:
        document = json.dumps(json.loads(signed.document) | changes, sort_keys=True, separators=(",", ":")).encode()
        return replace(signed, document=document, signature=sign_as_controller(key_of("custodian-1"), document))

    return forge


async def refused(ward: NoticeWard, txid: bytes) -> str:
    with pytest.raises(BlockRobotError) as caught:
        await ConsentReceipts(ward.wallet).obtain(txid)
    assert caught.value.code == "CONSENT_RECEIPT_INVALID"
    content = ward.wallet.store.content
    assert (content.receipts, content.receipts_due) == ([], [txid]), "it is neither signed nor kept, and still due"
    return caught.value.detail


async def test_each_word_has_a_receipt_in_the_fields_of_the_standard(ward: NoticeWard) -> None:
    kept = ConsentReceipts(ward.wallet)
    for entry, status in (("give", "given"), ("refuse", "refused"), ("withdraw", "withdrawn")):
        txid = await say(ward, entry)
        receipt = await kept.obtain(txid)
        fields = receipt.fields
        assert (fields["record_id"], fields["pii_principal_id"]) == (txid.hex(), ward.patient.handle.hex())
        assert fields["pii_controllers"][0]["party_contact"] == demo_notice().controller.contact
        assert fields["privacy_notice"]["version"] == 1
        assert (fields["purposes"][0]["purpose"], fields["purposes"][0]["lawful_basis"]) == ("care", "Art. 6(1)(a)")
        (event,) = fields["events"]
        assert (event["event_state"], event["event_id"]) == (status, txid.hex())
        assert fields["chain"]["height"] == ward.chain.height
        for name in ("schema_version", "retention_period", "recipient_third_parties", "jurisdiction", "privacy_rights"):
            assert fields[name]
    assert [each.statement.status for each in (await kept.all()).checked] == ["given", "refused", "withdrawn"]


async def test_both_sides_signed_and_equal_words_get_equal_bytes(ward: NoticeWard) -> None:
    txid = await say(ward)
    await ConsentReceipts(ward.wallet).obtain(txid)
    (entry,) = (await ConsentReceipts(ward.wallet).all()).entries
    document, signature = entry.document.encode(), bytes.fromhex(entry.controller_signature)
    assert signature == sign_as_controller(key_of("custodian-1"), document)
    assert bytes.fromhex(entry.person_signature) == sign_as_person(ward.wallet.keys.identity, document, signature)
    again = ward.network.issuer.issue(ward.network.ledger, txid, ward.wallet.keys.identity.public_key)
    assert (again.document, again.signature) == (document, signature)


async def test_the_first_consent_of_who_registers_has_one_too(ward: NoticeWard) -> None:
    found = await ConsentReceipts(ward.wallet).all(search=True)
    (receipt,) = found.checked
    assert (receipt.statement.status, receipt.statement.sensors) == ("given", ("depth",))
    assert receipt.published is None, "she registered before the notice came"
    assert receipt.fields["privacy_notice"] is None


async def test_a_forged_signature_is_refused(ward: NoticeWard) -> None:
    ward.network.forge = lambda signed: replace(signed, signature=bytes(64))
    assert "did not sign" in await refused(ward, await say(ward))


@pytest.mark.parametrize(
    "changes",
    [
        {"purposes": []},
        {"withdrawal_method": "Not at all."},
        {"events": []},
        {"chain": {}},
        {"pii_principal_id": "00" * 32},
        {"more": "than was said"},
    ],
)
async def test_words_that_are_not_those_of_the_chain_are_refused(ward: NoticeWard, changes: dict[str, Any]) -> None:
    ward.network.forge = changed(**changes)
    assert "not those of the chain" in await refused(ward, await say(ward))


@pytest.mark.parametrize("document", [b"", b"[]", b"{}", b"{", b'{"privacy_notice":null,"pii_controllers":[]}'])
async def test_what_is_no_receipt_at_all_is_refused(ward: NoticeWard, document: bytes) -> None:
    ward.network.forge = lambda signed: replace(signed, document=document)
    assert "form" in await refused(ward, await say(ward))


async def test_the_receipt_of_another_word_is_refused(ward: NoticeWard) -> None:
    first, second = await say(ward), await say(ward, "refuse", ("research",))
    member = ward.wallet.keys.identity.public_key
    other = ward.network.issuer.issue(ward.network.ledger, first, member)
    ward.network.forge = lambda _: other
    await refused(ward, second)


async def test_the_receipt_of_another_person_is_refused(ward: NoticeWard) -> None:
    ben = ward.chain.enrol("ben")
    theirs = ward.chain.must(ben.identity, "consent", "refuse", ben.handle, ["care"], [])
    other = ward.network.issuer.issue(ward.network.ledger, theirs.txid, ben.identity.public_key)
    ward.network.forge = lambda _: other
    await refused(ward, await say(ward))


async def test_a_node_signs_for_nobody_but_whose_word_it_is(ward: NoticeWard) -> None:
    txid = await say(ward)
    ben = ward.chain.enrol("ben")
    for who, code in ((ben.identity, "NOT_FOUND"), (key_of("stranger"), "CONSENT_RECEIPT_ELSEWHERE")):
        with pytest.raises(BlockRobotError, match=rf"^{code}:"):
            ward.network.issuer.issue(ward.network.ledger, txid, who.public_key)
    visit = ward.chain.must(ward.wallet.keys.identity, "identity", "authenticate", ward.patient.handle)
    with pytest.raises(BlockRobotError, match=r"^CONSENT_WORD_MISSING:"):
        ward.network.issuer.issue(ward.network.ledger, visit.txid, ward.wallet.keys.identity.public_key)


@pytest.mark.parametrize(
    ("purpose", "sensor", "code"),
    [
        ("safety", "rgb", "SENSOR_NOT_IN_NOTICE"),
        ("audit", "depth", "CONSENT_NOT_ASKED"),
        ("teaching", "depth", "PURPOSE_NOT_IN_NOTICE"),
    ],
)
async def test_nobody_countersigns_a_consent_beyond_the_notice(
    ward: NoticeWard, purpose: str, sensor: str, code: str
) -> None:
    """Whoever has a program of her own can write it into the chain: the organisation does not sign it, nor does she."""
    txid = (await ConsentClient(ward.wallet).give([purpose], [sensor])).txid
    issuer, member = ward.network.issuer, ward.wallet.keys.identity.public_key
    with pytest.raises(BlockRobotError, match=rf"^{code}:"):
        issuer.issue(ward.network.ledger, txid, member)
    with pytest.MonkeyPatch.context() as node_of_before:
        node_of_before.setattr("node.custody.coordination.consent_receipts.require_consent_asked", lambda *_: None)
        with pytest.raises(BlockRobotError) as caught:
            await ConsentReceipts(ward.wallet).obtain(txid)
    assert caught.value.code == code
    assert ward.wallet.store.content.receipts == []
    (missing,) = (await ConsentReceipts(ward.wallet).all()).missing
    assert (missing[0], missing[1].code) == (txid, code)
    for entry in ("refuse", "withdraw"):
        no = await ConsentReceipts(ward.wallet).obtain(await say(ward, entry, (purpose,)))
        assert no.published is not None, "a no is signed in any case"


async def test_who_is_no_custodian_signs_nothing_that_counts(ward: NoticeWard) -> None:
    forger = key_of("stranger")
    ward.network.forge = lambda signed: replace(
        signed, key=forger.public_key, signature=sign_as_controller(forger, signed.document)
    )
    assert "no custodian" in await refused(ward, await say(ward))


async def test_a_receipt_that_names_another_version_of_the_notice_is_refused(ward: NoticeWard) -> None:
    ward.publish(other_words())
    txid = await say(ward)
    seen = ConsentReceipts(ward.wallet)
    good = ward.network.issuer.issue(ward.network.ledger, txid, ward.wallet.keys.identity.public_key)
    notice = json.loads(good.document)["privacy_notice"]
    assert notice["version"] == 2
    for version in (0, 1, 3):
        ward.network.forge = changed(privacy_notice=notice | {"version": version} if version else None)
        with pytest.raises(BlockRobotError, match=r"^CONSENT_RECEIPT_INVALID:"):
            await seen.obtain(txid)
    ward.network.forge = lambda signed: signed
    assert (await seen.obtain(txid)).published is not None


async def test_the_notice_is_the_one_that_she_knew_though_another_came_in_between(ward: NoticeWard) -> None:
    """As `wallet consent give` does it: told, she reads, another version is published, and then she says yes."""
    notices = Notices(ward.wallet)
    told = await notices.current()
    ward.publish(other_words())
    word = await ConsentClient(ward.wallet).give(["care"], ["rgb"], seen_height=told.height)
    receipt = await ConsentReceipts(ward.wallet).obtain(word.txid)
    assert receipt.published is not None
    assert (told.version, receipt.published.row.version) == (1, 1)
    notices.note_consented(told)
    changed = await notices.changed_since_consent()
    assert changed is not None
    assert changed.version == 2


async def test_a_receipt_makes_nothing_count_as_read_that_was_never_shown(ward: NoticeWard) -> None:
    notices = Notices(ward.wallet)
    notices.note_shown(await notices.current())
    ward.publish(other_words())
    receipt = await ConsentReceipts(ward.wallet).obtain(await say(ward))
    assert receipt.published is not None
    assert receipt.published.row.version == 2
    assert ward.wallet.store.content.notice_consented_version == 1
    assert (await notices.current()).changes
    content = ward.wallet.store.content
    content.receipts, content.notice_consented_version, content.notice_shown_version = [], 0, 0
    await ConsentReceipts(ward.wallet).all(search=True)
    assert content.notice_consented_version == 2, "said with another copy of the wallet: nobody here knows better"


@pytest.mark.parametrize(
    "changes",
    [
        {"privacy_notice": {"version": (1 << 32) - 1}},
        {"privacy_notice": {"version": 1 << 32}},
        {"pii_controllers": [{"party_id": "\ud800ward"}]},
    ],
)
async def test_what_is_no_key_of_any_state_is_refused_and_stands_in_no_words_way(
    ward: NoticeWard, changes: dict[str, Any]
) -> None:
    txid = await say(ward, "withdraw", ())
    ward.network.forge = changed(**changes)
    taken = await try_fetch_receipt(ward.wallet, txid)
    assert taken.refusal is not None
    assert taken.refusal.code == "CONSENT_RECEIPT_INVALID"
    assert "form" in await refused(ward, txid)


async def test_a_wallet_that_cannot_be_written_hides_no_word(ward: NoticeWard, monkeypatch: pytest.MonkeyPatch) -> None:
    txid = await say(ward, "withdraw", ())

    def full() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(ward.wallet.store, "save", full)
    taken = await try_fetch_receipt(ward.wallet, txid)
    assert taken.refusal is not None
    assert taken.refusal.code == "FILE_UNUSABLE"
    assert "No space left on device" in receipt_line(taken)


@pytest.mark.parametrize("longest", ["ASK_NODE_MAX_S", "ASK_MAX_S"])
async def test_a_custodian_that_keeps_silent_keeps_no_word_waiting(
    ward: NoticeWard, monkeypatch: pytest.MonkeyPatch, longest: str
) -> None:
    """One is passed over after its time, all together after theirs; who answers is heard."""
    txid, answer, asked = await say(ward, "withdraw", ()), ward.network.ask_node, []
    node, silent = ward.network.custody.custodians[0], SimpleNamespace(name="silent")

    async def keep_silent(to: Any, method: str, path: str, **given: Any) -> bytes:
        if to is silent:
            asked.append(path)
            await asyncio.Event().wait()
        return await answer(to, method, path, **given)

    monkeypatch.setattr(ward.network, "ask_node", keep_silent)
    monkeypatch.setattr(wallet_receipts, longest, 0.01)
    monkeypatch.setattr(ward.network.custody, "custodians", (silent, node))
    async with asyncio.timeout(30):
        taken = await try_fetch_receipt(ward.wallet, txid)
    assert asked == ["/v1/consent-receipts"]
    if longest == "ASK_NODE_MAX_S":
        assert taken.receipt is not None
    else:
        assert taken.refusal is not None
        assert taken.refusal.code == "NODE_UNREACHABLE"
        assert "silent did not answer" in receipt_line(taken)


async def test_a_stranger_checks_the_file_offline(ward: NoticeWard, tmp_path: Path) -> None:
    kept = ConsentReceipts(ward.wallet)
    await kept.obtain(await say(ward))
    await kept.obtain(await say(ward, "withdraw", ()))
    path = tmp_path / "receipts.json"
    path.write_bytes(file.encode_file(ward.genesis, kept.epochs(), (await kept.all()).entries))
    found = file.check_file(path, ward.genesis)
    assert [each.statement.status for each in found.receipts] == ["given", "withdrawn"]
    assert found.is_anchored
    with pytest.raises(BlockRobotError, match="another network"):
        file.check_file(path, bytes(32))
    untrue, damaged = "CONSENT_RECEIPT_INVALID", "RECEIPT_FILE_DAMAGED"
    for old, new, code in (
        (b'\\"event_state\\":\\"given\\"', b'\\"event_state\\":\\"taken\\"', untrue),
        (b'"person_signature": "', b'"person_signature": "00', untrue),
        (b'"blockrobot-consent-receipts"', b'"blockrobot-consent-receipt5"', damaged),
        (b'"epochs": []', b'"epochs": ["00"]', damaged),
        (path.read_bytes()[-700:], b"", damaged),
    ):
        assert old in path.read_bytes(), old
        (tmp_path / "forged.json").write_bytes(path.read_bytes().replace(old, new, 1))
        with pytest.raises(BlockRobotError) as caught:
            file.check_file(tmp_path / "forged.json")
        assert caught.value.code == code, old
        assert ("wallet consent receipts --out" in caught.value.next_step) == (code == damaged)


async def test_a_receipt_proves_that_who_signed_it_had_registered_her(ward: NoticeWard, tmp_path: Path) -> None:
    """With her own signature beside it a node of any organisation of the network could sign."""
    kept = ConsentReceipts(ward.wallet)
    statement = (await kept.obtain(await say(ward))).statement
    (entry,) = (await kept.all()).entries
    place = MEMBER.key(statement.member)
    (snapshot,) = entry.state.snapshots
    less = [part for part in snapshot.keys if bytes.fromhex(part.key) != place]
    assert len(less) == len(snapshot.keys) - 1
    state = msgspec.structs.replace(entry.state, snapshots=[msgspec.structs.replace(snapshot, keys=less)])
    path = tmp_path / "receipts.json"
    for each, is_proved in ((entry, True), (msgspec.structs.replace(entry, state=state), False)):
        path.write_bytes(file.encode_file(ward.genesis, kept.epochs(), [each]))
        (found,) = file.check_file(path, ward.genesis).receipts
        assert found.is_registrars == is_proved, "a receipt of before lacks the proof, and counts without it"
        told = CliRunner().invoke(verify, [str(path)])
        assert ("had registered the owner" in told.output.replace("\n", " ")) != is_proved
    proved = ProvedChain(ward.genesis, kept.epochs()).state("it", entry.state)
    assert file._is_registrars(proved, found.organisation, statement)
    for organisation, handle in (("other", statement.handle), (found.organisation, bytes(32))):
        with pytest.raises(BlockRobotError, match="did not register the owner"):
            file._is_registrars(proved, organisation, replace(statement, handle=handle))
    with pytest.raises(BlockRobotError, match="did not register the owner"):
        file._is_registrars({place: replace(proved[place], value=None)}, found.organisation, statement)


async def test_a_file_without_receipts_or_with_one_twice_is_refused(ward: NoticeWard, tmp_path: Path) -> None:
    kept = ConsentReceipts(ward.wallet)
    await kept.obtain(await say(ward))
    entries, path = (await kept.all()).entries, tmp_path / "receipts.json"
    for listed, told in (((), "no receipt"), (entries * 2, "twice")):
        path.write_bytes(file.encode_file(ward.genesis, kept.epochs(), listed))
        with pytest.raises(BlockRobotError, match=told) as caught:
            file.check_file(path, ward.genesis)
        assert caught.value.code == "RECEIPT_FILE_DAMAGED"


def test_no_file_is_written_of_no_receipt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consent_commands, "run_with_wallet", lambda *_: (wallet_receipts.Receipts((), (), ()), b"{}"))
    path = tmp_path / "receipts.json"
    for more in ((), ("--json",)):
        result = CliRunner().invoke(consent_commands.receipts, ["--out", str(path), *more])
        assert result.exit_code == 0, result.output
        assert str(path) not in result.stdout
    assert json.loads(result.stdout)["file"] is None
    assert not path.exists()


async def test_a_file_of_receipts_is_for_its_owner_alone_and_not_where_a_link_leads(
    ward: NoticeWard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = ConsentReceipts(ward.wallet)
    await kept.obtain(await say(ward))
    found = await kept.all()
    content = file.encode_file(ward.genesis, kept.epochs(), found.entries)
    monkeypatch.setattr(consent_commands, "run_with_wallet", lambda *_: (found, content))
    path, link, target = tmp_path / "receipts.json", tmp_path / "link.json", tmp_path / "target"
    link.symlink_to(target)
    assert CliRunner().invoke(consent_commands.receipts, ["--out", str(path)]).exit_code == 0
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (content, 0o600)
    for taken in (path, link):
        refused = CliRunner().invoke(consent_commands.receipts, ["--out", str(taken)])
        assert (refused.exit_code != 0, "FILE_EXISTS" in refused.stderr) == (True, True), refused.output
    assert not target.exists()


async def test_a_receipt_that_was_fetched_twice_is_told_once(ward: NoticeWard) -> None:
    kept, txid = ConsentReceipts(ward.wallet), await say(ward)
    for _ in range(2):
        await kept.obtain(txid)
    found = await kept.all()
    assert ([each.statement.txid for each in found.checked], len(found.entries)) == ([txid], 1)


async def test_a_receipt_without_the_persons_own_signature_is_none(ward: NoticeWard) -> None:
    kept = ConsentReceipts(ward.wallet)
    await kept.obtain(await say(ward))
    (entry,) = (await kept.all()).entries
    stranger = PrivateKey(bytes([7] * 32))
    other = sign_as_person(stranger, entry.document.encode(), bytes.fromhex(entry.controller_signature)).hex()
    for signature in ("", other):
        forged = msgspec.structs.replace(entry, person_signature=signature)
        with pytest.raises(BlockRobotError, match="did not sign"):
            file.check_entry(ProvedChain(ward.genesis, []), ward.genesis, forged)


async def test_a_receipt_that_could_not_be_had_is_fetched_later(ward: NoticeWard) -> None:
    txid = await say(ward)
    custodians, ward.network.custody.custodians = ward.network.custody.custodians, ()
    kept = ConsentReceipts(ward.wallet)
    with pytest.raises(BlockRobotError, match=r"^CONSENT_RECEIPT_ELSEWHERE:"):
        await kept.obtain(txid)
    assert [each[0] for each in (await kept.all()).missing] == [txid]
    ward.network.custody.custodians = custodians
    found = await kept.all()
    assert ([each.statement.txid for each in found.checked], found.missing) == ([txid], ())


async def test_bytes_all_over_a_file_are_not_changed_without_showing(ward: NoticeWard, tmp_path: Path) -> None:
    kept = ConsentReceipts(ward.wallet)
    await kept.obtain(await say(ward))
    content = file.encode_file(ward.genesis, kept.epochs(), (await kept.all()).entries)
    path, good = tmp_path / "receipts.json", json.loads(content)
    # Every 211th byte: one check takes milliseconds, and a file has tens of thousands of bytes.
    for place in range(0, len(content), 211):
        flipped = bytearray(content)
        flipped[place] ^= 1
        path.write_bytes(flipped)
        try:
            if json.loads(flipped) == good:
                continue
        except ValueError:
            pass
        with pytest.raises(BlockRobotError) as caught:  # a chain's id is of all its genesis file but the state root
            file.check_file(path, ward.genesis)
        assert caught.value.code in {"CONSENT_RECEIPT_INVALID", "RECEIPT_FILE_DAMAGED", "BUNDLE_OTHER_CHAIN"}, place
