"""Registering at the command line: first she is told, and nobody consents to anything that was not named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from clients.bundle.cli import verify
from clients.wallet.cli import main as cli
from clients.wallet.commands import consent_commands, notice_commands
from clients.wallet.consent.receipt_fetching import ConsentReceipts
from consensus.members.vouchers import encode_card_code
from consensus.state.consent import NOTICE
from network.notices.notice_publishing import demo_notice
from tests.world.commands import open_for_commands
from tests.world.notices import NoticeWard


class RegistrationHarness:
    """A ward that hands out cards, and the wallet of who comes."""

    def __init__(self, folder: Path) -> None:
        self.ward = NoticeWard(folder)
        self.wallet = self.ward.open_wallet("new")
        self.code = encode_card_code(self.ward.chain.card("newcomer"))

    @property
    def words(self) -> dict[str, list[str]]:
        found = self.ward.chain.value("consent", b"of/" + self.wallet.store.content.handle) or {}
        return {purpose: sorted(sensors) for purpose, sensors in found.items()}


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RegistrationHarness:
    opened = RegistrationHarness(tmp_path)

    open_for_commands(monkeypatch, lambda: opened.wallet)
    return opened


def run(*arguments: str) -> Result:
    return CliRunner().invoke(cli.wallet, ["--genesis", "genesis.json", *arguments])


def ok(*arguments: str) -> str:
    """Run it, saying yes beforehand where it would ask a program for that."""
    result = run(*arguments, *(["--yes"] if "--purpose" in arguments else []))
    assert result.exit_code == 0, result.output
    return " ".join(result.output.split())


def ok_json(*arguments: str) -> str:
    result = run(*arguments, "--yes", "--json")
    assert result.exit_code == 0, result.output
    return result.output


def other_words() -> Any:
    return msgspec.structs.replace(demo_notice(), automated_decisions="None, in other words.")


def test_who_names_no_purpose_consents_to_nothing_and_is_told(desk: RegistrationHarness) -> None:
    assert "consented to nothing" in ok("register", desk.code)
    assert desk.words == {}
    assert json.loads(run("register", desk.code, "--json").output)["purposes"] == []


def test_who_names_purposes_consents_to_these_and_has_the_receipt(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    told = ok("register", desk.code, "--purpose", "care", "--purpose", "demo")
    assert "for: care, demo." in told
    assert desk.words == {"care": ["depth"], "demo": ["depth"]}
    assert "signed by ward and by you, under version 1 of the notice" in told


def test_the_notice_comes_before_the_word(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    told = ok("register", desk.code, "--purpose", "care")
    for words in (demo_notice().controller.name, demo_notice().officer.contact, "Art. 6(1)(a)", "Art. 77", "desk"):
        assert words in told
    assert told.index(demo_notice().authority.name) < told.index("You are registered")
    asked = [key for key in desk.ward.network.public_keys if key == NOTICE.key("ward")]
    assert asked, "it is read before there is a session"
    assert desk.wallet.store.content.notice_shown_version == 1


def test_where_nothing_is_published_she_is_told_that(desk: RegistrationHarness) -> None:
    told = ok("register", desk.code, "--purpose", "care")
    assert "ward has published no privacy notice" in told
    assert "no notice was published" in told


def test_a_damaged_card_is_refused_before_anything_is_shown(desk: RegistrationHarness) -> None:
    wrong = desk.code[:-3] + "AAA"
    result = run("register", wrong, "--json")
    assert (result.exit_code, json.loads(result.output)["error"]["code"]) == (1, "VOUCHER_INVALID")


def test_a_program_has_the_notice_in_the_answer(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    told = json.loads(ok_json("register", desk.code, "--purpose", "care"))
    assert (told["notice"]["organisation"], told["notice"]["version"]) == ("ward", 1)
    assert (told["receipt"]["notice_version"], told["receipt_error"]) == (1, None)


def test_what_changed_since_she_consented_is_said_and_shown(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    ok("register", desk.code, "--purpose", "care")
    assert "changed since" not in ok("records")
    assert "changed since" not in ok("notice")
    desk.ward.publish(other_words())
    command = f"blockrobot wallet --genesis {Path('genesis.json').absolute()}"
    assert f"What ward tells you changed since you consented: {command} notice" in ok("records")
    assert json.loads(run("records", "--json").output)["notice_changed_to"] == 2
    told = ok("notice")
    assert "that was under version 1, and version 2 came" in told
    assert f"- Automated decisions: {demo_notice().automated_decisions}" in told
    assert "+ Automated decisions: None, in other words." in told
    assert desk.words == {"care": ["depth"]}, "a changed notice ends no consent"


def test_a_new_version_is_shown_before_the_next_consent_and_holds_for_it(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    ok("register", desk.code)
    assert "Responsible:" not in ok("consent", "give", "--purpose", "care"), "it was shown when she registered"
    desk.ward.publish(other_words())
    told = ok("consent", "give", "--purpose", "care")
    assert told.index("None, in other words.") < told.index("You consent to")
    assert "under version 2 of the notice" in told
    assert "changed since" not in ok("records")


def publish_while_she_reads(desk: RegistrationHarness, monkeypatch: pytest.MonkeyPatch, *notices: Any) -> None:
    """As at a terminal: a version comes while each of the first questions waits for an answer."""
    waiting = list(notices)

    def read(*_: Any, **__: Any) -> str:
        if waiting:
            desk.ward.publish(waiting.pop(0))
        return "y"

    monkeypatch.setattr(notice_commands, "can_ask", lambda: True)
    monkeypatch.setattr("click.prompt", read)


def test_a_version_that_comes_while_she_reads_is_not_the_one_that_she_consents_under(
    desk: RegistrationHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    ok("register", desk.code)
    desk.ward.publish(demo_notice())
    publish_while_she_reads(desk, monkeypatch, other_words())
    told = " ".join(run("consent", "give", "--purpose", "care").output.split())
    assert "in other words" not in told
    assert "under version 1 of the notice" in told
    assert "changed since you consented" in ok("records")


def test_a_version_that_comes_while_she_reads_is_shown_before_she_is_registered(
    desk: RegistrationHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.ward.publish(demo_notice())
    publish_while_she_reads(desk, monkeypatch, other_words())
    told = " ".join(run("register", desk.code, "--purpose", "care").output.split())
    assert told.index("None, in other words.") < told.index("You are registered")
    assert "under version 2 of the notice" in told
    assert "changed since" not in ok("records")


def test_a_version_that_comes_while_she_registers_is_not_taken_for_one_that_she_read(
    desk: RegistrationHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.ward.publish(demo_notice())
    register = desk.wallet.register

    async def late(*arguments: Any) -> Any:
        desk.ward.publish(other_words())
        return await register(*arguments)

    monkeypatch.setattr(desk.wallet, "register", late)
    told = ok("register", desk.code, "--purpose", "care")
    assert "under version 2 of the notice. That version came while you registered" in told
    assert "changed since you consented" in ok("records")


@pytest.mark.parametrize("arguments", [["notice"], ["consent", "give", "--purpose", "care", "--yes"]])
@pytest.mark.parametrize("as_json", [[], ["--json"]])
def test_what_could_not_be_printed_does_not_count_as_shown(
    desk: RegistrationHarness, monkeypatch: pytest.MonkeyPatch, arguments: list[str], as_json: list[str]
) -> None:
    ok("register", desk.code)
    desk.ward.publish(demo_notice())
    content = desk.wallet.store.content

    def closed(*_: Any) -> None:
        raise BrokenPipeError

    with monkeypatch.context() as patches:
        for module in (notice_commands, consent_commands):
            patches.setattr(module, "print_answer", closed)
        patches.setattr(notice_commands, "show_notice", closed)
        patches.setattr("clients.sdk.terminal.terminal.os.dup2", lambda *_: None)
        run(*arguments, *as_json)
    assert (content.notice_shown_version, content.notice_consented_version) == (0, 0)
    assert run(*arguments, *as_json).exit_code == 0
    assert content.notice_shown_version == 1


@pytest.mark.parametrize(
    ("arguments", "counts"),
    [
        (["consent", "withdraw"], "It holds from block"),
        (["consent", "give", "--purpose", "care"], "It holds from block"),
        (["register", "CODE", "--purpose", "care"], "You are registered"),
    ],
)
def test_what_counts_is_told_before_anybody_is_asked_for_a_receipt(
    desk: RegistrationHarness, monkeypatch: pytest.MonkeyPatch, arguments: list[str], counts: str
) -> None:
    if arguments[0] == "consent":
        ok("register", desk.code)

    async def burst(*_: Any, **__: Any) -> Any:
        raise RuntimeError

    monkeypatch.setattr(ConsentReceipts, "obtain", burst)
    yes = ["--yes"] if "--purpose" in arguments else []
    result = run(*[desk.code if part == "CODE" else part for part in arguments], *yes)
    assert isinstance(result.exception, RuntimeError)
    assert counts in result.output


def test_receipts_are_listed_written_and_checked_by_anybody(desk: RegistrationHarness, tmp_path: Path) -> None:
    desk.ward.publish(demo_notice())
    ok("register", desk.code, "--purpose", "care")
    ok("consent", "withdraw")
    path = tmp_path / "receipts.json"
    listed = ok("consent", "receipts", "--out", str(path))
    assert "given: care by depth" in listed
    assert "withdrawn: everything by every sensor" in listed
    assert run("consent", "receipts", "--out", str(path)).exit_code != 0, "it overwrites nothing"
    checked = CliRunner().invoke(verify, [str(path), "--genesis", desk.ward.genesis.block_id.hex(), "--json"])
    told = json.loads(checked.output)
    assert (told["ok"], told["is_anchored"]) == (True, True)
    assert [row["status"] for row in told["signed_consent_receipts"]] == ["given", "withdrawn"]
    plain = CliRunner().invoke(verify, [str(path)])
    assert (plain.exit_code, "signed by both sides" in plain.output) == (0, True)
    path.write_text(path.read_text().replace('\\"given\\"', '\\"taken\\"', 1))
    forged = CliRunner().invoke(verify, [str(path), "--json"])
    assert (forged.exit_code, json.loads(forged.output)["error"]["code"]) == (1, "CONSENT_RECEIPT_INVALID")


def test_a_notice_that_cannot_be_read_stands_in_the_way_of_a_yes_and_never_of_a_no(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    ok("register", desk.code, "--purpose", "care")
    desk.ward.chain.must(desk.ward.chain.admin, "consent", "publish_notice", b"what nobody can read")
    given = run("consent", "give", "--purpose", "demo", "--json")
    assert (given.exit_code, json.loads(given.output)["error"]["code"]) == (1, "NOTICE_INVALID")
    told = json.loads(run("consent", "withdraw", "--json").output)
    assert (told["ok"], told["status"], told["receipt"], told["receipt_error"]) == (
        True,
        "withdrawn",
        None,
        "NOTICE_INVALID",
    )
    assert json.loads(run("records", "--json").output)["notice_changed_to"] == 2


def test_a_yes_whose_receipt_is_late_is_still_one_under_the_words_that_were_shown(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    desk.ward.network.custody.custodians = ()
    told = ok("register", desk.code, "--purpose", "care")
    assert "Your receipt is not here yet" in told
    desk.ward.publish(other_words())
    assert "changed since you consented" in ok("records")


def without_care() -> Any:
    """A notice that does not name care."""
    kept = [purpose for purpose in demo_notice().purposes if purpose.code != "care"]
    return msgspec.structs.replace(demo_notice(), purposes=kept)


def refusal(*arguments: str) -> tuple[str, str]:
    error = json.loads(run(*arguments, "--yes", "--json").output)["error"]
    return error["code"], error["detail"]


def test_nobody_consents_to_a_purpose_that_the_notice_does_not_name(desk: RegistrationHarness) -> None:
    """What she was never told of she cannot know what she agrees to: it is refused before anything is signed."""
    desk.ward.publish(without_care())
    code, detail = refusal("register", desk.code, "--purpose", "demo", "--purpose", "care")
    assert (code, "'care'" in detail, "demo" in detail) == ("PURPOSE_NOT_IN_NOTICE", True, True)
    assert desk.wallet.store.content.handle == b""
    ok("register", desk.code, "--purpose", "demo")
    assert refusal("consent", "give", "--purpose", "care")[0] == "PURPOSE_NOT_IN_NOTICE"
    assert desk.words == {"demo": ["depth"]}
    assert json.loads(run("consent", "refuse", "--purpose", "care", "--json").output)["ok"], "a no needs no notice"
    desk.ward.publish(demo_notice())
    assert "You consent to: care" in ok("consent", "give", "--purpose", "care")


def test_nobody_consents_to_a_sensor_that_the_notice_does_not_name_for_the_purpose(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    ok("register", desk.code, "--purpose", "safety")
    code, detail = refusal("consent", "give", "--purpose", "safety", "--sensor", "depth", "--sensor", "rgb")
    assert (code, "'rgb'" in detail, "depth" in detail) == ("SENSOR_NOT_IN_NOTICE", True, True)
    assert desk.words == {"safety": ["depth"]}, "what is partly refused is refused as a whole"
    assert json.loads(run("consent", "refuse", "--purpose", "safety", "--sensor", "rgb", "--json").output)["ok"]


def test_nobody_consents_to_what_does_not_rest_on_consent(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    code, detail = refusal("register", desk.code, "--purpose", "audit")
    assert (code, "Art. 6(1)(c)" in detail) == ("CONSENT_NOT_ASKED", True)
    assert desk.wallet.store.content.handle == b""
    ok("register", desk.code)
    assert refusal("consent", "give", "--purpose", "audit", "--sensor", "audio")[0] == "CONSENT_NOT_ASKED"
    assert desk.words == {}
    for word in ("refuse", "withdraw"):
        assert json.loads(run("consent", word, "--purpose", "audit", "--json").output)["ok"], "a no is always heard"


def test_what_she_once_agreed_to_she_can_take_back_after_the_notice_names_it_no_more(desk: RegistrationHarness) -> None:
    ok("register", desk.code)
    ok("consent", "give", "--purpose", "safety", "--sensor", "rgb")
    desk.ward.publish(demo_notice())
    assert desk.words == {"safety": ["rgb"]}, "a changed notice ends no consent"
    taken = json.loads(run("consent", "withdraw", "--purpose", "safety", "--sensor", "rgb", "--json").output)
    assert (taken["ok"], taken["count"]) == (True, 1)
    (row,) = json.loads(run("consent", "list", "--json").output)["choices"]
    assert row["status"] == "withdrawn"


def test_without_a_terminal_a_consent_is_said_with_yes_or_not_at_all(desk: RegistrationHarness) -> None:
    desk.ward.publish(demo_notice())
    for as_json in ([], ["--json"]):
        refused = run("register", desk.code, "--purpose", "care", *as_json)
        assert (refused.exit_code, "--yes" in refused.output) == (2, True)
    assert desk.wallet.store.content.handle == b""
    assert run("register", desk.code).exit_code == 0, "who consents to nothing is not asked"
    desk.ward.publish(other_words())
    unseen = run("consent", "give", "--purpose", "care")
    assert (unseen.exit_code, "--yes" in unseen.output) == (2, True)
    assert desk.words == {}
    assert run("notice").exit_code == 0
    assert run("consent", "give", "--purpose", "care").exit_code == 0, "she has seen it, and named what she gives"


def test_a_program_at_a_terminal_is_asked_on_the_side(
    desk: RegistrationHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.ward.publish(demo_notice())
    monkeypatch.setattr(notice_commands, "can_ask", lambda: True)
    asked: list[Any] = []
    monkeypatch.setattr("click.prompt", lambda *_, **more: asked.append(more["err"]) or "y")
    result = run("register", desk.code, "--purpose", "care", "--json")
    assert (asked, json.loads(result.stdout)["ok"]) == ([True], True)
    assert "Responsible:" in result.stderr


@pytest.mark.parametrize(
    "command", ["records", "view", "verify", "audit", "shares", "inbox", "handle", "consent list", "erasures", "export"]
)
def test_who_is_not_registered_is_told_how_to_be(desk: RegistrationHarness, tmp_path: Path, command: str) -> None:
    arguments = [*command.split(), str(tmp_path / "mine.zip"), "--yes"] if command == "export" else command.split()
    done = CliRunner().invoke(cli.wallet, ["--profile", "ann", *arguments])
    assert done.exit_code == 1, done.output
    assert (
        "NOT_REGISTERED. Next step: Register with the code on your card: `blockrobot wallet --profile ann register"
        in (done.stderr)
    )
