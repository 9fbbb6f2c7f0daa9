"""A thief was faster, in one way or another: what she still can do goes on, and she is told what she cannot."""

from __future__ import annotations

from pathlib import Path

import pytest

from clients.wallet.ledger.visit_audit import audit_all
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.former_text import exposed
from clients.wallet.records.erasure import ErasureClient
from clients.wallet.recovery.key_rotation import KeyRotation
from clients.wallet.store.keystore import KnownVisit
from clients.wallet.store.member_keys import derive_keys, draw_words
from consensus.errors import BlockRobotError
from consensus.state.records import decided_root
from tests.unit.clients.wallet.test_rotating import no_words, refusal, rotate
from tests.world.stolen import OLD_WORDS, Story, no_pause, take_new_words
from tests.world.ward import Patient

TRANSFERS_MAX_COUNT = 64


@pytest.fixture
def story(tmp_path: Path) -> Story:
    """Anna with three visits, all known to her wallet."""
    story = Story(tmp_path, OLD_WORDS)
    for number in range(1, 4):
        story.visit(number)
    return story


async def steal_membership(story: Story) -> Wallet:
    """Let a thief with her words put words of his own in their place; he moves no visit yet."""
    thief = story.copy("thief", OLD_WORDS, [])
    await take_new_words(thief)
    return thief


async def test_a_visit_that_can_be_moved_no_more_keeps_no_other_from_it(story: Story) -> None:
    """A thief moved it to and fro under the old words, as often as a visit is moved at all."""
    wallet = story.open()
    await wallet.scan()
    thief = story.copy("thief", OLD_WORDS, [])
    name = (await thief.scan())[1].owner
    for _ in range(TRANSFERS_MAX_COUNT):
        (moved,) = [visit for visit in await thief.scan() if visit.owner == name]
        await KeyRotation(thief).transfer(moved)
    rotating = await take_new_words(wallet)
    done = await rotating.transfer_all(0.0, no_words)
    assert (len(done.done), [visit.owner for visit in done.stuck], done.refusal) == (2, [name], None)
    content = story.open().store.content
    assert not content.transfers_due
    assert [visit.owner for visit in content.visits if visit.stuck] == [name]
    again = await take_new_words(story.open())
    done = await again.transfer_all(0.0, no_words)
    assert (len(done.done), len(done.stuck), done.refusal) == (2, 1, None)
    reports = {report.visit.owner: report for report in await story.open().records()}
    assert len(reports) == 3
    await ErasureClient(again._wallet).request(reports[name].visit, [reports[name].records[0].record_id], [])


async def test_a_refusal_that_may_pass_calls_no_visit_lost_keeps_no_other_and_is_told(
    story: Story, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Say, `records` has another version, and this wallet is of before."""
    wallet = story.open()
    name = (await wallet.scan())[1].owner
    rotating = await take_new_words(wallet)
    real = KeyRotation.transfer

    async def refused(self: KeyRotation, visit: KnownVisit) -> None:
        if visit.owner == name:
            raise BlockRobotError("CALL_REFUSED", "The call takes other arguments.", contract_code="ARGUMENTS_WRONG")
        await real(self, visit)

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(KeyRotation, "transfer", refused)
        done = await rotating.transfer_all(0.0, no_words)
    assert (len(done.done), done.stuck, done.refusal and done.refusal.code) == (2, (), "CALL_REFUSED")
    content = story.open().store.content
    assert (content.transfers_due, [visit.owner for visit in exposed(content)]) == (True, [name])
    for visit in content.visits:
        visit.stuck = visit.owner == name  # as wallets took it before
    again = story.open()
    again.store.content.visits = content.visits
    done = await KeyRotation(again, sleep=no_pause).transfer_all(0.0, no_words)
    assert ([visit.owner for visit in done.done], done.stuck, done.refusal) == ([name], (), None)


async def test_a_thief_who_moves_it_under_the_old_words_meanwhile_is_outrun(story: Story) -> None:
    wallet = story.open()
    await wallet.scan()
    thief = story.copy("thief", OLD_WORDS, [])
    await thief.scan()
    rotating = await take_new_words(wallet)
    real, count = story.chain.submit_and_wait, 0

    async def first_he(transaction: object) -> object:
        nonlocal count
        count += 1
        if count in {1, 2}:
            story.chain.submit_and_wait = real  # type: ignore[method-assign]
            root = decided_root(story.hospital.state, transaction.body.sender)  # type: ignore[attr-defined]
            await rob(root)
            story.chain.submit_and_wait = first_he  # type: ignore[method-assign,assignment]
        return await real(transaction)  # type: ignore[arg-type]

    async def rob(root: bytes | None) -> None:
        (visit,) = [visit for visit in thief.store.content.visits if visit.owner == root]
        await KeyRotation(thief).transfer(visit)

    story.chain.submit_and_wait = first_he  # type: ignore[method-assign,assignment]
    done = await rotating.transfer_all(0.0, no_words)
    assert (len(done.done), done.stuck, done.refusal, count) == (3, (), None, 5)
    assert all(visit.era == 1 for visit in story.open().store.content.visits)


async def test_what_the_thief_has_not_moved_she_still_sees_and_erases(story: Story) -> None:
    wallet = story.open()
    visits = [report.visit for report in await wallet.records()]
    assert not wallet.member_gone
    thief = await steal_membership(story)
    (lost,) = [visit for visit in await thief.scan() if visit.owner == visits[1].owner]
    await KeyRotation(thief).transfer(lost)
    again = story.open()
    reports = await again.records()
    assert again.member_gone
    assert [report.visit.owner for report in reports] == [visits[0].owner, visits[2].owner]
    assert [visit.owner for visit in again.out_of_reach] == [visits[1].owner]
    assert await audit_all(again)
    await ErasureClient(again).request(reports[0].visit, [reports[0].records[0].record_id], [])
    assert await refusal(KeyRotation(again).leave()) == "MEMBERSHIP_ENDED"


async def test_who_has_nothing_left_is_told_so(story: Story) -> None:
    await story.open().records()
    thief = await steal_membership(story)
    await KeyRotation(thief, sleep=no_pause).transfer_all(0.0, no_words)
    assert await refusal(story.open().records()) == "MEMBERSHIP_ENDED"


async def test_with_new_words_the_former_ones_and_a_new_card_visits_are_hers_again(story: Story) -> None:
    """The way that the page of a stolen wallet writes down. What the thief moved already stays out of reach."""
    names = [report.visit.owner for report in await story.open().records()]
    thief = await steal_membership(story)
    (lost,) = [visit for visit in await thief.scan() if visit.owner == names[0]]
    await KeyRotation(thief).transfer(lost)
    words = draw_words()
    person = Patient("ann again", keys=derive_keys(words))
    arguments = story.hospital.register_arguments(person, story.hospital.card("ann again"))
    story.hospital.must(person.identity, "identity", "register", *arguments)
    second = story.copy("second", words, [OLD_WORDS])
    done = await KeyRotation(second, sleep=no_pause).transfer_all(0.0, no_words)
    assert ({visit.owner for visit in done.done}, done.refusal) == (set(names[1:]), None)
    assert [visit.owner for visit in done.taken] == names[:1]
    assert [len(report.records) for report in await second.records()] == [2, 2]
    with pytest.raises(BlockRobotError, match="MEMBERSHIP_ENDED"):
        await story.open().records()


async def test_who_wanted_to_leave_and_was_robbed_has_not_left(story: Story) -> None:
    wallet = story.open()
    await wallet.records()
    real = story.chain.submit_and_wait

    async def away(_: object) -> object:
        raise BlockRobotError("NODE_UNREACHABLE")

    story.chain.submit_and_wait = away  # type: ignore[method-assign,assignment]
    assert await refusal(KeyRotation(wallet).leave()) == "NODE_UNREACHABLE"
    story.chain.submit_and_wait = real  # type: ignore[method-assign]
    assert not story.open().store.content.left
    await steal_membership(story)
    again = story.open()
    assert len(await again.records()) == 3
    assert again.member_gone
    assert await refusal(KeyRotation(again).leave()) == "MEMBERSHIP_ENDED"
    assert not story.open().store.content.left


async def test_who_left_without_hearing_of_it_has_left(story: Story) -> None:
    """Her word is final, the answer was lost: the receipt says so, which needs no session. Also after a second try."""
    real = story.chain.submit_and_wait

    async def deaf(transaction: object) -> object:
        await real(transaction)  # type: ignore[arg-type]
        raise BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME")

    wallet = story.open()
    await wallet.records()
    story.chain.submit_and_wait = deaf  # type: ignore[method-assign,assignment]
    assert await refusal(KeyRotation(wallet).leave()) == "TRANSACTION_NOT_FINAL_IN_TIME"
    again = story.open()
    assert len(await again.records()) == 3
    assert not again.member_gone
    assert story.open().store.content.left
    assert await KeyRotation(again).leave() == 0


async def test_receipts_that_are_due_go_with_the_words_that_spoke(story: Story) -> None:
    wallet = story.open()
    wallet.store.content.receipts_due = [bytes(32)]
    await rotate(wallet)
    assert story.open().store.content.receipts_due == []
