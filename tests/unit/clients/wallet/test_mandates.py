"""A mandate as officers, a mother and a child type it: papers, receipts, words for another, what each wallet tells.

The contracts are the real ones and everything is proven; only the wire is short.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from clients.officer import breach_commands, officer_mandates_commands
from clients.officer.mandate_papers import make_receipt, read_receipt, write_receipt
from clients.wallet.cli import main as wallet_cli
from clients.wallet.cli import wallet_context
from clients.wallet.consent.receipt_fetching import ConsentReceipts
from clients.wallet.ledger.mandates import Mandates
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE, LANGUAGES
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.members.handles import encode_short
from consensus.primitives.keys import PrivateKey
from consensus.rights.consent_receipts import read_statement
from consensus.state.identity import REMOVED
from tests.json_answers import differences
from tests.unit.contracts.privacy.hospital import DAY_MS
from tests.world.commands import open_for_commands, sit_at_terminal
from tests.world.transcripts import Transcript
from tests.world.ward import Ward

Run = Callable[..., Result]


class FamilyHarness:
    """A ward in which a child, a mother and two officers have wallets; the papers lie in a folder."""

    def __init__(self, folder: Path) -> None:
        ward = Ward(folder)
        self.chain, self.folder = ward.chain, folder
        self.wallets = {
            name: ward.come_in(name, role, purposes=())
            for name, role in (
                *(("child", "subject"), ("mother", "subject"), ("nurse", "staff")),
                *(("eva", "officer"), ("max", "officer")),
            )
        }
        (folder / "birth.pdf").write_bytes(b"Mother: Maria")
        (folder / "court.pdf").write_bytes(b"In the name of the people")

    def handle(self, name: str) -> str:
        return encode_short(self.wallets[name].store.content.handle)

    @property
    def until(self) -> str:
        return officer_mandates_commands.format_time(self.chain.bucket() + 30 * DAY_MS)

    def proposal(self, *papers: str) -> list[str]:
        """How the first officer proposes that the mother acts for the child."""
        words = ["propose", "--for", self.handle("child"), "--to", self.handle("mother"), "--reason", "minor"]
        for paper in papers or ("birth.pdf",):
            words += ["--papers", str(self.folder / paper)]
        return [*words, "--until", self.until]


@pytest.fixture
def house(tmp_path: Path) -> FamilyHarness:
    return FamilyHarness(tmp_path)


@pytest.fixture
def run(house: FamilyHarness, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Call a command as one of the four: officers `officer mandates ...`, the others `wallet ...`."""
    who = ["child"]
    open_for_commands(monkeypatch, lambda: house.wallets[who[0]])

    def call(name: str, *arguments: str) -> Result:
        who[0] = name
        if name in ("eva", "max"):
            return CliRunner().invoke(breach_commands.officer, ["--profile", name, "mandates", *arguments])
        return CliRunner().invoke(wallet_cli.wallet, list(arguments))

    return call


@pytest.fixture
def name(house: FamilyHarness, run: Run) -> str:
    """A mandate that is in force."""
    receipt, paper = str(house.folder / "r.json"), str(house.folder / "birth.pdf")
    proposed = json.loads(run("eva", *house.proposal(), "--receipt", receipt, "--yes", "--json").stdout)
    found: str = proposed["mandate_id"][:12]
    assert run("max", "approve", found, "--receipt", receipt, "--papers", paper, "--yes").exit_code == 0
    assert run("mother", "mandates", "accept", found, "--yes").exit_code == 0
    return found


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_whole_way_as_it_is_typed(
    house: FamilyHarness, run: Run, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    say, child = transcript.follow(run), house.handle("child")
    give = ("consent", "give", "--for", child, "--purpose", "care", "--yes")
    say("eva", *house.proposal())
    say("eva", *house.proposal("birth.pdf", "court.pdf"), "--yes")
    (place,) = house.folder.glob("mandate-*.json")
    (listed,) = json.loads(run("max", "list", "--json").stdout)["mandates"]
    name = listed["mandate_id"][:12]
    assert (listed["papers"], listed["status"]) == (read_receipt(place).commitment.hex(), "proposed")
    say("child", "records")
    say("child", "mandates", "list")
    papers = [word for file in ("court.pdf", "birth.pdf") for word in ("--papers", str(house.folder / file))]
    say("max", "approve", name, "--receipt", str(place), *papers, "--yes")
    say("mother", "mandates", "list")
    say("mother", "mandates", "accept", name)
    say("mother", "mandates", "accept", name, "--yes")
    say("mother", *give)
    (row,) = json.loads(run("child", "consent", "list", "--json").stdout)["choices"]
    assert (row["status"], row["mandate_id"]) == ("given", listed["mandate_id"])
    say("mother", "consent", "list", "--for", child)
    assert json.loads(run("mother", "consent", "list", "--json").stdout)["choices"] == [], "nothing of her own"
    say("child", "mandates", "list")
    say("child", "mandates", "end", name)
    say("mother", *give)
    (row,) = json.loads(run("child", "consent", "list", "--json").stdout)["choices"]
    assert row["status"] == "withdrawn"
    say("child", "mandates", "list")
    assert json.loads(run("child", "records", "--json").stdout)["mandate_id"] is None
    say("eva", "list")
    assert json.loads(run("eva", "list", "--all", "--json").stdout)["mandates"][0]["status"] == "ended"
    transcript.compare(f"mandates.{language}")


def test_every_answer_is_as_documented(house: FamilyHarness, run: Run, name: str) -> None:
    child = house.handle("child")
    for who, command, words in (
        ("mother", "wallet consent refuse", ("--for", child, "--purpose", "demo")),
        ("mother", "wallet consent withdraw", ("--for", child)),
        ("mother", "wallet object", ("--for", child, "--purpose", "research")),
        ("mother", "wallet mandates list", ("--all",)),
        ("mother", "wallet consent list", ("--for", child)),
        ("child", "wallet mandates end", (name,)),
        ("eva", "officer mandates list", ("--all",)),
    ):
        called = command.split()[1:] if who in ("mother", "child") else command.split()[2:]
        answered = run(who, *called, *words, "--json")
        assert differences(command, json.loads(answered.stdout)) == [], answered.output
    kinds = [
        act["kind"]
        for act in json.loads(run("child", "mandates", "list", "--all", "--json").stdout)["mandates"][0]["trail"]
    ]
    assert kinds == ["refused", "objected"], "nothing was left to withdraw"


def test_no_word_for_another_is_kept_or_receipted_as_ones_own(house: FamilyHarness, run: Run, name: str) -> None:
    mother = house.wallets["mother"]
    answer = json.loads(
        run("mother", "consent", "give", "--for", house.handle("child"), "--purpose", "care", "--yes", "--json").stdout
    )
    assert answer["mandate_id"].startswith(name)
    assert (answer["receipt"], answer["receipt_error"]) == (None, None)
    assert not mother.store.content.receipts_due
    assert bytes.fromhex(answer["txid"]) not in mother.store.content.proofs
    height = answer["height"]
    (wire,), (receipt,) = house.chain.blocks[height - 1].transactions, house.chain.receipts[height - 1]
    with pytest.raises(BlockRobotError) as refusal:
        read_statement(decode_transaction(wire), receipt, height=height, index=0, time_ms=0)
    assert refusal.value.code == "CONSENT_WORD_MISSING", "no node signs that this key is the person's"
    assert bytes.fromhex(answer["txid"]) not in asyncio.run(ConsentReceipts(mother).find_words())


def test_who_has_no_mandate_is_told_so_before_anything_is_sent(house: FamilyHarness, run: Run, name: str) -> None:
    height = house.chain.height
    for who, whom, code in (
        ("child", house.handle("mother"), "MANDATE_MISSING"),
        ("mother", house.wallets["eva"].store.content.handle.hex(), "MANDATE_MISSING"),
        ("mother", "ab" * 32, "HANDLE_NOT_FOUND"),
        ("mother", "somebody", "HANDLE_NOT_FOUND"),
        ("mother", house.handle("child")[:-1] + "q", "HANDLE_MISTYPED"),
    ):
        refused = json.loads(run(who, "consent", "withdraw", "--for", whom, "--json").stdout)
        assert refused["error"]["code"] == code, refused
    assert house.chain.height == height
    assert run("mother", "mandates", "end", "ffffffff").exit_code != 0


def test_the_childs_own_no_is_told_with_a_next_step(house: FamilyHarness, run: Run, name: str) -> None:
    assert run("child", "consent", "refuse", "--purpose", "demo").exit_code == 0
    refused = run("mother", "consent", "give", "--for", house.handle("child"), "--purpose", "demo", "--yes")
    assert "OWN_NO_STANDS" in refused.stderr
    assert "Leave that purpose out, or end it with the person's own yes" in refused.stderr


def test_the_second_officer_agrees_to_the_papers_that_the_first_one_saw(house: FamilyHarness, run: Run) -> None:
    place = house.folder / "r.json"
    proposed = json.loads(
        run("eva", *house.proposal("birth.pdf", "court.pdf"), "--receipt", str(place), "--yes", "--json").stdout
    )
    assert differences("officer mandates propose", proposed) == []
    assert (place.stat().st_mode & 0o777, proposed["receipt"]) == (0o600, str(place))
    name = proposed["mandate_id"][:12]
    other = house.folder / "other.json"
    write_receipt(other, make_receipt([house.folder / "birth.pdf", house.folder / "court.pdf"], "minor"))
    forged = house.folder / "forged.pdf"
    forged.write_bytes(b"Mother: Mario")
    birth, court = house.folder / "birth.pdf", house.folder / "court.pdf"
    for receipt, papers in (
        (other, (birth, court)),
        (place, (birth,)),
        (place, (birth, court, forged)),
        (birth, (birth,)),
    ):
        named = [word for paper in papers for word in ("--papers", str(paper))]
        refused = json.loads(run("max", "approve", name, "--receipt", str(receipt), *named, "--yes", "--json").stdout)
        assert refused["error"]["code"] == "MANDATE_PAPERS_OTHER"
    missing = run("max", "approve", name, "--receipt", str(house.folder / "none"), "--papers", str(birth), "--json")
    assert json.loads(missing.stdout)["error"]["code"] == "FILE_UNUSABLE"
    assert asyncio.run(Mandates(house.wallets["max"]).find(name)).status == "proposed"


def test_a_receipt_is_never_written_over_and_goes_if_nothing_was_proposed(house: FamilyHarness, run: Run) -> None:
    place = house.folder / "r.json"
    place.write_text("mine", encoding="utf-8")
    refused = json.loads(run("eva", *house.proposal(), "--receipt", str(place), "--yes", "--json").stdout)
    assert (refused["error"]["code"], place.read_text(encoding="utf-8")) == ("FILE_EXISTS", "mine")
    new = house.folder / "new.json"
    words = house.proposal()
    words[words.index("--to") + 1] = house.handle("eva")
    refused = json.loads(run("eva", *words, "--receipt", str(new), "--yes", "--json").stdout)
    assert "OFFICER_CONCERNED" in refused["error"]["detail"]
    assert not new.exists()


@pytest.mark.parametrize("code", ["TRANSACTION_EXPIRED", "TRANSACTION_NOT_FINAL_IN_TIME", "NODE_UNREACHABLE"])
def test_a_proposal_that_the_network_did_not_take_is_made_again_by_the_same_command(
    house: FamilyHarness, run: Run, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    place, real = house.folder / "r.json", Mandates.propose
    words, salts = [*house.proposal(), "--receipt", str(place), "--yes", "--json"], set[str]()

    async def down(*_: Any) -> bytes:
        salts.add(read_receipt(place).salt)
        raise BlockRobotError(code)

    monkeypatch.setattr(Mandates, "propose", down)
    for _ in range(2):
        assert json.loads(run("eva", *words).stdout)["error"]["code"] == code
    assert place.exists() == (code != "TRANSACTION_EXPIRED"), "it goes if it is sure that nothing was proposed"
    assert len(salts) == (2 if code == "TRANSACTION_EXPIRED" else 1), "the first may be on the chain: the same salt"
    monkeypatch.setattr(Mandates, "propose", real)
    proposed = json.loads(run("eva", *words).stdout)
    assert proposed["papers"] == read_receipt(place).commitment.hex()
    assert "MANDATE_EXISTS" in json.loads(run("eva", *words).stdout)["error"]["detail"]
    assert place.exists(), "the receipt of the proposal that stands stays"
    other = [*house.proposal("court.pdf"), "--receipt", str(place), "--yes", "--json"]
    assert json.loads(run("eva", *other).stdout)["error"]["code"] == "FILE_EXISTS"


def test_questions_leave_the_json_alone(house: FamilyHarness, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    receipt, paper = str(house.folder / "r.json"), str(house.folder / "birth.pdf")
    asked: list[bool] = []
    monkeypatch.setattr(wallet_context, "ask", lambda _, err=False: asked.append(err))
    sit_at_terminal(monkeypatch)
    proposed = json.loads(run("eva", *house.proposal(), "--receipt", receipt, "--json").stdout)
    found = proposed["mandate_id"][:12]
    assert json.loads(run("max", "approve", found, "--receipt", receipt, "--papers", paper, "--json").stdout)["ok"]
    assert json.loads(run("mother", "mandates", "accept", found, "--json").stdout)["ok"]
    assert asked == [True] * 3


async def test_whoever_is_a_member_closes_what_holds_no_more(house: FamilyHarness, run: Run, name: str) -> None:
    child, mother = (house.wallets[who].store.content.handle for who in ("child", "mother"))
    house.chain.must(
        house.wallets["mother"].keys.identity,
        "consent",
        "give",
        *[child, ["care"], ["depth"], 0, house.chain.bucket() + DAY_MS, 0, house.chain.height],
    )
    handling = Mandates(house.wallets["nurse"])
    with pytest.raises(BlockRobotError, match="MANDATE_HOLDS"):
        await handling.end(await handling.find(name))
    house.chain.must(house.chain.admin, "identity", "revoke", mother)
    await handling.end(await handling.find(name))
    assert (await handling.find(name)).status == "ended"
    assert house.chain.view("consent", "choices", child)["care"]["depth"][-1][1] == "withdrawn"


def test_salt_reason_and_papers_are_all_in_the_commitment(house: FamilyHarness) -> None:
    paths = [house.folder / "birth.pdf", house.folder / "court.pdf"]
    one = make_receipt(paths, "minor")
    assert one.commitment != make_receipt(paths, "minor").commitment, "the salt is drawn"
    place = house.folder / "receipt.json"
    write_receipt(place, one)
    assert read_receipt(place) == one
    content = json.loads(place.read_text(encoding="utf-8"))
    for changed in (
        content | {"reason": "court-order"},
        content | {"papers": content["papers"][:1]},
        content | {"salt": "00" * 32},
    ):
        place.write_text(json.dumps(changed), encoding="utf-8")
        assert read_receipt(place).commitment != one.commitment
    for changed in (
        content | {"reason": "so-it-seems"},
        content | {"papers": []},
        content | {"salt": "00"},
        content | {"format": "other"},
        content | {"more": 1},
    ):
        place.write_text(json.dumps(changed), encoding="utf-8")
        with pytest.raises(BlockRobotError, match=r"^MANDATE_PAPERS_OTHER:"):
            read_receipt(place)


def standing_as_told(run: Run) -> tuple[list[str], bool]:
    """What the mother's wallet lists, and whether the child's records say that somebody acts for the child, or is to."""
    listed = json.loads(run("mother", "mandates", "list", "--all", "--json").stdout)["mandates"]
    told = json.loads(run("child", "records", "--json").stdout)["mandate_id"] is not None
    shown = json.loads(run("child", "mandates", "list", "--json").stdout)["mandates"]
    assert told == bool(shown), "one function decides"
    return [one["status"] for one in listed], told


def test_every_wallet_tells_of_a_mandate_what_the_contract_says(house: FamilyHarness, run: Run, name: str) -> None:
    chain = house.chain
    mother, nurse = (house.wallets[who].store.content.handle for who in ("mother", "nurse"))
    assert standing_as_told(run) == (["active"], True)
    until_ms = chain.bucket() + 2 * DAY_MS
    arguments = [mother, nurse, bytes(32), ["consent"], until_ms]
    other = chain.must(house.wallets["eva"].keys.identity, "mandates", "propose", *arguments).txid
    for who, entry in (("max", "approve"), ("nurse", "accept")):
        chain.must(house.wallets[who].keys.identity, "mandates", entry, other)
    assert standing_as_told(run) == (["resting", "active"], True)
    refused = run("mother", "consent", "withdraw", "--for", house.handle("child"), "--json")
    assert json.loads(refused.stdout)["error"]["code"] == "MANDATE_MISSING"
    chain.time_ms = until_ms
    chain.block([])
    assert standing_as_told(run) == (["active", "lapsed"], True)
    chain.time_ms += 40 * DAY_MS
    chain.block([])
    assert standing_as_told(run) == (["lapsed", "lapsed"], False)


@pytest.mark.parametrize("gone", ["mother", "child"])
def test_a_mandate_of_who_is_gone_is_called_active_by_no_wallet(
    house: FamilyHarness, run: Run, name: str, gone: str
) -> None:
    house.chain.must(house.chain.admin, "identity", "revoke", house.wallets[gone].store.content.handle)
    other = {"mother": "child", "child": "mother"}[gone]
    (listed,) = json.loads(run(other, "mandates", "list", "--all", "--json").stdout)["mandates"]
    assert listed["status"] == "lapsed"


def test_nor_is_one_of_an_organisation_that_was_removed_since(
    house: FamilyHarness, run: Run, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    proven, removed = Wallet.values, REMOVED.key("ward")

    async def values(wallet: Wallet, keys: Sequence[bytes], session: PrivateKey) -> dict[bytes, Any]:
        found = await proven(wallet, keys, session)
        return found | ({removed: house.chain.time_ms} if removed in keys else {})

    monkeypatch.setattr(Wallet, "values", values)
    assert standing_as_told(run) == (["lapsed"], False)


def test_a_wallet_reads_only_the_mandates_that_name_its_person(house: FamilyHarness, run: Run, name: str) -> None:
    child, nurse = house.wallets["child"], house.wallets["nurse"]
    assert asyncio.run(Mandates(nurse).read_own()) == []
    for _ in range(2):
        (found,) = asyncio.run(Mandates(child).read_own())
        assert found.mandate_id.hex().startswith(name)
    with pytest.raises(BlockRobotError, match="MANDATE_NOT_FOUND"):
        asyncio.run(Mandates(nurse).find(name, own=True))
