"""A patient's and a doctor's day at a terminal, on a real network: what they read, and each next step typed as printed.

Nothing here is called but the command line, and the robot that records. What is printed as a command is typed again
with no change, in a folder that is not the program's.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from typing import Any
from zipfile import ZipFile

import pytest_asyncio
from pexpect import EOF

from clients.wallet.store.keystore import Keystore
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.typed import CONTROL, WIPED, Typed, at_terminal, plain, type_line
from tests.walking_alone import UID

PASSPHRASE = r"(?i)(?:pass|frase)[^:\r\n]*: "
ASKED = r"\[(?:y/N|s/N)\]: "
PORTUGUESE = {"environment": {"BLOCKROBOT_LANGUAGE": "pt"}}
NARROW = {"environment": {"LC_ALL": "C", "NO_COLOR": "1"}, "columns": 40}


class Somebody:
    """A person at her terminal. The files that she writes lie in a folder of hers."""

    def __init__(self, network: RecordedNetwork, profile: str, **terminal: Any) -> None:
        self.network = network
        self.profile = profile
        self.terminal = terminal
        self.folder = network.folder / f"{profile}'s desk"
        self.folder.mkdir(exist_ok=True)

    async def types(self, *arguments: str, answers: tuple[str, ...] = (), code: int = 0, **terminal: Any) -> str:
        """Type a command of her wallet, answer what it asks, and return all that was written, as it was written."""
        where = {"folder": self.folder, **self.terminal, **terminal}
        return await self._follow(
            lambda: at_terminal(self.network.folder, "--profile", self.profile, *arguments, **where), answers, code
        )

    async def repeats(self, printed: str, answers: tuple[str, ...] = (), code: int = 0) -> str:
        """Type a line as it was printed, and return all that was written."""
        return await self._follow(
            lambda: type_line(self.network.folder, printed, folder=self.folder, **self.terminal), answers, code
        )

    async def _follow(self, begin: Any, answers: tuple[str, ...], code: int) -> str:
        def follow() -> str:
            typed: Typed = begin()
            seen, left, prompts = "", list(answers), [ASKED, EOF, PASSPHRASE]
            while (found := typed.expect(prompts)) != prompts.index(EOF):
                seen += str(typed.before) + str(typed.after)
                if prompts[found] == PASSPHRASE:
                    typed.sendline(self.network.passphrase)
                    prompts.remove(PASSPHRASE)
                else:
                    assert left, f"nobody expected {plain(seen)}"
                    typed.sendline(left.pop(0))
            assert not left, f"it did not ask: {plain(seen)}"
            seen += str(typed.before)
            ended = typed.ended()
            assert ended == code, CONTROL.sub("", seen)
            assert "Traceback" not in seen
            return seen

        return await asyncio.to_thread(follow)

    async def make_wallet(self) -> None:
        """Make a wallet file, as quickly as it can be."""
        async with self.network.wallet(self.profile):
            pass


def step(told: str, pattern: str) -> str:
    """Return the one command that is printed and fits the pattern."""
    found = re.findall(rf"(blockrobot {pattern})", plain(told))
    assert len(found) == 1, (pattern, plain(told))
    return str(found[0])


class Day:
    """The network, and ann, whom a robot records once she is registered and consents."""

    def __init__(self, network: RecordedNetwork) -> None:
        self.network = network
        self.ann = Somebody(network, network.profile)
        self.told = ""
        """What ann read when she registered."""

    async def record(self) -> None:
        """Let ann register at the terminal and be recorded, unless she was."""
        if self.network.records:
            return
        code = self.network.issue_card(UID, "subject")
        self.told = await self.ann.types("register", code, "--purpose", "demo", answers=("y",))
        await self.network.prepare_robot()
        await self.network.record()

    @property
    def visit(self) -> str:
        """Her visit's name, as much of it as is shown."""
        return self.network.records[0].visit.owner.hex()[:12]


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def day(tmp_path_factory: Any) -> AsyncIterator[Day]:
    network = RecordedNetwork(tmp_path_factory.mktemp("story"))
    try:
        await network.start_unregistered()
        yield Day(network)
    finally:
        await network.close()


async def test_she_registers_says_yes_checks_what_was_recorded_and_reads_what_happened(day: Day) -> None:
    ann = day.ann
    first = plain(await ann.types("records", code=1))
    assert "This wallet is not registered yet." in first
    assert "blockrobot wallet --profile ann register CODE" in first
    code = day.network.issue_card(UID, "subject")
    refused = plain(await ann.types("register", code, "--purpose", "demo", answers=("n",), code=1))
    assert "Demonstration Hospital" in refused, "she reads before she is asked"
    assert refused.endswith("Nothing was done."), refused
    assert "not registered yet" in plain(await ann.types("handle", code=1))

    await day.record()
    told = plain(day.told)
    assert told.index("Purpose demo: A demonstration") < told.index("Register, and consent to be recorded")
    assert "You are registered, and consent to be recorded by a depth camera for: demo." in told
    assert "The receipt is in your wallet, signed by hospital and by you, under version 1 of the notice." in told
    listed = plain(await ann.repeats(step(told, r"wallet --profile ann consent list")))
    assert "yes demo by depth: given" in listed
    given = plain(await ann.types("consent", "give", "--purpose", "research", "--sensor", "depth"))
    assert "You consent to: research (Research that an ethics board has approved.)" in given
    taken = plain(await ann.types("consent", "withdraw", "--purpose", "research"))
    assert "You took back: research" in taken
    assert "Visit 1" in await ann.repeats(step(taken, r"wallet --profile ann records"))
    assert "no research by depth: withdrawn" in plain(await ann.types("consent", "list"))

    verified = plain(await ann.types("verify"))
    count = len(day.network.records)
    assert count > 0
    assert verified.count("pictures are as the robot took them.") == count
    story = plain(await ann.repeats(step(verified, r"wallet --profile ann audit")))
    assert "A robot met you and began to record, for: demo." in story
    assert "node-1 of hospital handed out" in story
    checked = (
        f"You checked {count} recordings: they are as the robot took them." if count > 1 else "You checked it: it is"
    )
    assert story.count(checked) == 1, "one look at a meeting is one entry"
    assert all(record.record_id.hex() in story for record in day.network.records)
    assert "What hospital tells you (version 1, proved on the chain):" in plain(await ann.types("notice"))


async def test_a_doctor_is_shown_a_visit_looks_and_deletes_what_is_shared_no_more(day: Day) -> None:
    await day.record()
    ann, weber = day.ann, Somebody(day.network, "weber")
    await weber.make_wallet()
    code = day.network.issue_card("D0C7", "staff")
    told = plain(await weber.types("register", code, answers=("y",)))
    assert "You are registered, and have consented to nothing: no robot records you." in told
    told = plain(await weber.types("handle"))
    handle = re.search(r"(?:[0-9a-f]{8} ){7}[0-9a-f]{8}", told)
    assert handle is not None
    assert "Nothing was shared with you" in plain(await weber.repeats(step(told, r"wallet --profile weber inbox")))

    share = ("share", "--visit", day.visit, "--with", handle[0], "--as", "Dr Weber", "--purpose", "care", "--for", "7d")
    plan = plain(await ann.types(*share, answers=("n",), code=1))
    assert "with Dr Weber, staff of hospital" in plan
    assert "What cannot be undone" in plan
    assert plan.endswith("Nothing was done."), plan
    assert "You have not shared anything." in await ann.repeats(
        step(plan.partition("You can end")[2], r"wallet --profile ann shares")
    )
    shared = plain(await ann.types(*share, answers=("y",)))
    end = step(shared, r"wallet --profile ann revoke [0-9a-f]+")

    looked = await weber.repeats(step(await weber.types("inbox"), r"wallet --profile weber look [0-9a-f]+"))
    assert plain(looked).count("as the robot took them.") == len(day.network.records)
    assert list((weber.folder / "shared").rglob("*.depth.png"))
    assert "whom you shared with looked at" in plain(await ann.types("inbox"))
    shares = plain(await ann.types("shares"))
    assert "records could be fetched then" in shares
    assert step(shares, r"wallet --profile ann revoke [0-9a-f]+") == end

    ended = plain(await ann.repeats(end))
    assert "shared with Dr Weber" in ended
    assert "you ended it" in plain(await ann.repeats(step(ended, r"wallet --profile ann shares")))
    assert "You had ended that already" in plain(await ann.repeats(end))
    inbox = plain(await weber.types("inbox"))
    assert "are shared no more, their owner ended it: delete every copy" in inbox
    assert "Ask the person to share it again" in plain(
        await weber.repeats(end.replace("ann revoke", "weber look"), code=3)
    )
    confirm = step(inbox, r"wallet --profile weber confirm-deleted [0-9a-f]+")
    remain = plain(await weber.repeats(confirm, code=1))
    assert "COPIES_REMAIN. Next step: Delete them, or give --delete" in remain
    assert "Nothing was done." in plain(await weber.repeats(f"{confirm} --delete", answers=("n",), code=1))
    assert list((weber.folder / "shared").rglob("*.depth.png"))
    deleted = plain(await weber.repeats(f"{confirm} --delete", answers=("y",)))
    assert "The owner sees now that you have deleted your copies" in deleted
    assert not list((weber.folder / "shared").rglob("*.png"))
    assert "says that copies of" in plain(await ann.types("shares"))
    story = plain(await ann.types("audit"))
    assert "says that the copies of 6 recordings are deleted." in story
    assert end.rpartition(" ")[2] in story


async def test_she_takes_all_along_and_anybody_can_check_it_by_the_printed_command(day: Day) -> None:
    await day.record()
    ann, file = day.ann, "all of mine.zip"
    declined = plain(await ann.types("export", file, answers=("n",), code=1))
    assert "Whoever has it learns:" in declined
    assert declined.endswith("Nothing was done."), declined
    assert not (ann.folder / file).exists()
    written = await ann.types("export", file, answers=("y",))
    with ZipFile(ann.folder / file) as bundle:
        assert "play.html" in bundle.namelist()
    check = step(written, r"verify '.*\.zip' --genesis \S+")
    typed = type_line(day.network.folder, check, folder=ann.folder)
    assert await asyncio.to_thread(typed.ended) == 0, typed.rest()
    assert "records" in plain(typed.rest())
    content = bytearray((ann.folder / file).read_bytes())
    content[len(content) // 2] ^= 1
    (ann.folder / file).write_bytes(content)
    forged = type_line(day.network.folder, check, folder=ann.folder)
    assert await asyncio.to_thread(forged.ended) != 0
    assert "Next step: " in plain(forged.rest())


async def test_in_portuguese_she_is_refused_what_nobody_told_her_says_no_and_then_yes(day: Day) -> None:
    maria = Somebody(day.network, "maria", **PORTUGUESE)
    await maria.make_wallet()
    code = day.network.issue_card("A1A1A1", "subject")
    damaged = plain(await maria.types("register", "BR1-ESTRAGADO", code=1))
    assert "Próximo passo: " in damaged
    unknown = plain(await maria.types("register", code, "--purpose", "nonsense", code=1))
    assert "O aviso de privacidade em vigor não nomeia esta finalidade" in unknown
    assert "PURPOSE_NOT_IN_NOTICE. Próximo passo: " in unknown
    declined = plain(await maria.types("register", code, "--purpose", "demo", answers=("n",), code=1))
    assert declined.endswith("Nada foi feito."), declined
    nothing = plain(await maria.types("register", code, answers=("talvez", "s")))
    assert "Responda s (sim) ou n (não)." in nothing
    given = await maria.repeats(step(nothing, r"wallet --profile maria consent give --purpose demo --sensor depth"))
    assert "Consente" in plain(given)
    assert "Ainda não aconteceu nada" in plain(await maria.types("audit"))
    declined = plain(await maria.types("leave", answers=("não",), code=1))
    assert declined.endswith("Nada foi feito."), declined
    left = plain(await maria.types("leave", answers=("sim",)))
    assert "blockrobot wallet --profile maria records" in left


async def test_a_narrow_terminal_without_colour_and_utf_8_gets_it_all_in_plain_letters(day: Day) -> None:
    await day.record()
    ann = Somebody(day.network, day.network.profile, **NARROW)
    zoe = Somebody(day.network, "zoe", **NARROW)
    await zoe.make_wallet()
    told = [await zoe.types("register", day.network.issue_card("20E", "subject"), "--purpose", "demo", answers=("y",))]
    for command in (["consent", "list"], ["notice"], ["inbox"], ["handle"], ["shares"], ["records"], ["audit"]):
        told.append(await zoe.types(*command))
        told.append(await ann.types(*command))
    told.append(await ann.types("verify"))
    for each in told:
        assert each.isascii(), [letter for letter in each if not letter.isascii()]
        assert not re.search(r"\x1b\[[0-9;]*m", each), "no colour"
    assert "You are registered, and consent to be recorded by a depth camera for: demo." in plain(told[0])
    portuguese = NARROW | {"environment": NARROW["environment"] | {"BLOCKROBOT_LANGUAGE": "pt"}}
    story = await ann.types("audit", **portuguese)
    assert story.isascii()
    assert re.search(r"Verificou(-a| \d+ gravacoes): esta(o)? tal como o robo as? fez\.", plain(story))


async def test_new_words_are_shown_asked_back_and_in_force_after_a_theft(day: Day) -> None:
    await day.record()
    ann = day.ann

    def rotate() -> str:
        typed = at_terminal(day.network.folder, "--profile", ann.profile, "rotate", "--over-minutes", "0")
        typed.answer(PASSPHRASE, day.network.passphrase)
        typed.answer(ASKED, "y")
        typed.expect("When all of it is written down, press Enter: ")
        shown = dict(re.findall(r"(\d+) ([a-z]+)", CONTROL.sub("", str(typed.before))))
        assert len(shown) == 24
        typed.sendline("")
        typed.expect_exact(WIPED)
        typed.expect(r"(?i)word number (\d+): ")
        typed.sendline(shown[typed.match[1]])
        assert typed.ended() == 0, typed.rest()
        assert "1 visit has a key of your present words." in plain(typed.rest())
        return " ".join(shown[str(number)] for number in range(1, 25))

    words = await asyncio.to_thread(rotate)
    store = await asyncio.to_thread(Keystore.open, day.network.wallet_dir / "ann.wallet", day.network.passphrase)
    assert store.content.words == words
    assert "Visit 1" in plain(await ann.types("records"))
    assert "You moved this meeting to a new key of yours." in plain(await ann.types("audit"))
