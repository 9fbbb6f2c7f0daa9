"""The wallet was stolen: new words, a new member key, a new key for each visit; cut off anywhere, it goes on."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from clients.wallet.ledger.visit_audit import audit_all
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.records.erasure import ErasureClient
from clients.wallet.recovery.key_rotation import KeyRotation
from clients.wallet.store.keystore import GivenGrant, Keystore, KnownVisit, WalletContent
from clients.wallet.store.member_keys import derive_keys, draw_words
from consensus.errors import BlockRobotError
from tests.world.stolen import OLD_WORDS, PowerCut, Story, give_grant, no_pause, take_new_words
from tests.world.ward import Patient


def no_words(_: int, __: int, ___: float) -> None:
    """Nobody looks at the progress."""


@pytest.fixture
def story(tmp_path: Path) -> Story:
    """Anna with two visits, and one of a stranger between them."""
    story = Story(tmp_path, OLD_WORDS)
    story.visit(1)
    story.hospital.open_visit(story.hospital.enrol("stranger"))
    story.visit(2)
    return story


async def rotate(wallet: Wallet) -> KeyRotation:
    """Do everything that `wallet rotate` does."""
    rotating = KeyRotation(wallet, sleep=no_pause)
    if wallet.store.content.next_words or not wallet.store.content.former:
        rotating.prepare()
        if rotating.must_show:
            rotating.confirm_shown()
        await rotating.rotate()
    done = await rotating.transfer_all(600.0, no_words)
    assert done.refusal is None
    return rotating


async def refusal(work: object) -> str:
    """Return the code by which something is refused."""
    with pytest.raises(BlockRobotError) as caught:
        await work  # type: ignore[misc]
    return caught.value.code


async def test_the_new_words_see_and_decide_of_what_the_old_ones_did(story: Story) -> None:
    wallet = story.open()
    before = {report.visit.owner: len(report.records) for report in await wallet.records()}
    assert list(before.values()) == [2, 2]
    await rotate(wallet)
    again = story.open()
    reports = await again.records()
    assert {report.visit.owner: len(report.records) for report in reports} == before
    assert [report.missing_count for report in reports] == [0, 0]
    first = reports[0]
    assert again.owner_key(first.visit).public_key == first.visit.current == story.current(first.visit) != b""
    await again.sign_and_wait(first.visit, "access", "request", [[first.records[0].record_id], "own-access"])
    await again.sign_and_wait(first.visit, "rights", "restrict", [[], "accuracy"])
    await ErasureClient(again).request(first.visit, [first.records[1].record_id], [])
    kinds = [entry.kind for entry in await audit_all(again) if entry.owner == first.visit.owner]
    assert kinds[-4:] == ["transferred", "access_requested", "restricted", "erasure_requested"]


async def test_the_member_key_comes_first_and_visits_one_by_one(story: Story) -> None:
    """The robots seal to the new keys from the next block on, before anything old is moved."""
    visits = {visit.owner for visit in await story.open().scan()}
    story.chain.calls.clear()
    await rotate(story.open())
    (rotated, *transferred) = story.chain.calls
    assert rotated == (story.person.identity.public_key, "rotate")
    assert [entry for _, entry in transferred] == ["transfer", "transfer"]
    assert {key for key, _ in transferred} == visits
    assert len({story.current(visit) for visit in story.open().store.content.visits} | visits) == 4


async def test_a_thief_with_the_old_words_is_refused_everywhere(story: Story) -> None:
    thief = story.copy("thief", OLD_WORDS, [])
    reports = await thief.records()
    await rotate(story.open())
    assert await refusal(thief.records()) == "MEMBERSHIP_ENDED"
    assert await refusal(KeyRotation(thief).leave()) == "MEMBERSHIP_ENDED"
    trails = [story.hospital.value("audit", b"count/" + report.visit.owner) for report in reports]
    for report in reports:
        visit, record_id = report.visit, report.records[0].record_id
        assert await refusal(thief.visit_report(visit)) == "SESSION_REFUSED"
        for contract, entry, arguments in (
            ("access", "request", [[record_id], "own-access"]),
            ("access", "verdict", [[[record_id, "verified", []]]]),
            ("erasure", "request", [[record_id], []]),
            ("rights", "restrict", [[], "accuracy"]),
            ("rights", "wrong_person", []),
        ):
            assert await refusal(thief.sign_and_wait(visit, contract, entry, arguments)) == "SENDER_NOT_ADMITTED"
        assert await refusal(KeyRotation(thief).transfer(visit)) == "SENDER_NOT_ADMITTED"
    rotating = KeyRotation(thief)
    rotating.prepare()
    rotating.confirm_shown()
    assert await refusal(rotating.rotate()) == "MEMBERSHIP_ENDED"
    assert trails == [story.hospital.value("audit", b"count/" + report.visit.owner) for report in reports]


async def test_cut_off_at_any_moment_it_ends_as_if_it_was_not(tmp_path: Path) -> None:
    """Before and after each saving and each call: the words on the disk are always those that the chain knows, or knew."""
    cut_at, cuts = 0, 0
    while True:
        folder = tmp_path / str(cut_at)
        folder.mkdir()
        story = Story(folder, OLD_WORDS)
        story.visit(1)
        story.visit(2)
        await story.open().records()
        story.power.moments, story.power.cut_at = 0, cut_at
        try:
            await rotate(story.open())
        except PowerCut:
            cuts += 1
        else:
            break
        content = Keystore.open(story.path, "tea and lemon cake").content
        member = story.hospital.view("identity", "member_of_handle", story.handle)["member"]
        known = [words for words in (content.words, content.next_words) if words]
        assert member in {derive_keys(words).identity.public_key for words in known}
        await rotate(story.open())
        wallet = story.open()
        assert wallet.store.content.former == [OLD_WORDS]
        assert wallet.store.content.next_words == ""
        reports = await wallet.records()
        assert [len(report.records) for report in reports] == [2, 2]
        assert all(wallet.owner_key(report.visit).public_key == story.current(report.visit) for report in reports)
        assert all(report.visit.era == 1 for report in reports)
        cut_at += 1
    assert cuts == cut_at > 15


def give_own(story: Story, wallet: Wallet, visit: KnownVisit) -> bytes:
    """Share a record as this wallet does, with a note of it."""
    grant_id = give_grant(story, wallet.owner_key(visit), visit, f"own {visit.sequence}")
    wallet.store.content.given_grants.append(GivenGrant(grant_id, visit.owner, bytes(32), "Dr Weber", bytes(32)))
    wallet.store.save()
    return grant_id


def status_of(story: Story, grant_id: bytes) -> str:
    return str(story.hospital.view("access", "grant_of", grant_id)["status"])


@pytest.mark.parametrize("keep", [False, True])
async def test_what_a_thief_shared_ends_with_the_visits_old_key_and_own_shares_go_on(story: Story, keep: bool) -> None:
    wallet = story.open()
    visits = await wallet.scan()
    thief = story.copy("thief", OLD_WORDS, [])
    own = [give_own(story, wallet, visit) for visit in visits]
    his = [give_grant(story, thief.owner_key(visit), visit, f"his {visit.sequence}") for visit in await thief.scan()]
    over = give_grant(story, thief.owner_key(visits[0]), visits[0], "over")
    story.hospital.must(thief.owner_key(visits[0]), "access", "revoke", over)
    story.chain.calls.clear()
    rotating = await take_new_words(wallet)
    done = await rotating.transfer_all(600.0, no_words, keep_shares=keep)
    assert (done.refusal, set(done.ended)) == (None, set() if keep else set(his))
    assert [status_of(story, grant_id) for grant_id in own] == ["active", "active"]
    assert [status_of(story, grant_id) for grant_id in his] == ["active" if keep else "revoked"] * 2
    entries = [entry for _, entry in story.chain.calls]
    each = ["transfer"] if keep else ["transfer", "revoke"]
    assert entries == ["rotate", *each, *each], "a visit's shares end beside its own transfer, not all at once"


async def test_what_a_thief_shares_at_the_last_moment_ends_too(story: Story) -> None:
    wallet = story.open()
    visits = await wallet.scan()
    thief, his = story.copy("thief", OLD_WORDS, []), list[bytes]()
    known = await thief.scan()

    async def share(_: float) -> None:
        left = [visit for visit in known if story.current(visit) == visit.owner]
        his.append(give_grant(story, thief.owner_key(left[0]), left[0], f"his {len(his)}"))

    rotating = await take_new_words(wallet, sleep=share)
    assert set((await rotating.transfer_all(600.0, no_words)).ended) == set(his)
    assert len(his) == len(visits)


async def test_cut_off_between_a_transfer_and_the_end_of_a_share_it_goes_on(tmp_path: Path) -> None:
    cut_at = 0
    while True:
        folder = tmp_path / str(cut_at)
        folder.mkdir()
        story = Story(folder, OLD_WORDS)
        story.visit(1)
        wallet = story.open()
        (visit,) = await wallet.scan()
        his = give_grant(story, wallet.owner_key(visit), visit, "his")
        story.power.moments, story.power.cut_at = 0, cut_at
        try:
            await rotate(story.open())
        except PowerCut:
            await rotate(story.open())
        else:
            break
        assert status_of(story, his) == "revoked"
        assert not any(visit.shares_due for visit in story.open().store.content.visits)
        cut_at += 1
    assert cut_at > 10


async def test_words_that_were_not_shown_are_shown_again_and_never_signed_with(story: Story) -> None:
    first = KeyRotation(story.open())
    words = first.prepare()
    again = KeyRotation(story.open())
    assert again.must_show
    assert await refusal(again.rotate()) == "VALUE_INVALID"
    assert again.prepare() == words
    again.confirm_shown()
    later = KeyRotation(story.open())
    assert not later.must_show
    assert await later.rotate()
    assert not await later.rotate()
    assert story.open().store.content.words == words


async def test_a_visit_that_comes_late_to_the_old_words_is_found_and_moved(story: Story) -> None:
    """A robot that was cut off brings what it recorded a day later, sealed to the old keys."""
    await rotate(story.open())
    late = story.visit(3)
    wallet = story.open()
    rotating = KeyRotation(wallet, sleep=no_pause)
    assert [visit.owner for visit in await rotating.exposed_visits()] == [late.owner]
    assert len((await wallet.records())[2].records) == 2
    done = await rotating.transfer_all(0.0, no_words)
    assert ([visit.owner for visit in done.done], done.taken, done.refusal) == ([late.owner], (), None)
    assert await rotating.exposed_visits() == []


async def test_records_that_come_after_the_transfer_are_there_too(story: Story) -> None:
    """The robot goes on with an open visit under its first key, and seals to the keys that it began with."""
    visit = story.visit(4)
    await rotate(story.open())
    story.record(visit, story.person, 2)
    assert len((await story.open().records())[2].records) == 3


async def test_who_restores_with_new_and_former_words_has_everything(story: Story) -> None:
    wallet = story.open()
    await rotate(wallet)
    new = wallet.store.content.words
    both = story.copy("both", new, [OLD_WORDS])
    reports = await both.records()
    assert [len(report.records) for report in reports] == [2, 2]
    assert [report.visit.sequence for report in reports] == [0, 2]
    alone = story.copy("alone", new, [])
    reports = await alone.records()
    assert [(len(report.records), len(report.unreadable_ids)) for report in reports] == [(0, 2), (0, 2)]
    await ErasureClient(alone).request(reports[0].visit, [reports[0].unreadable_ids[0]], [])


async def test_words_can_be_changed_again_and_again(story: Story) -> None:
    for _ in range(3):
        wallet = story.open()
        rotating = await take_new_words(wallet)
        await rotating.transfer_all(0.0, no_words)
    reports = await story.open().records()
    assert [(report.visit.era, len(report.records)) for report in reports] == [(3, 2), (3, 2)]


async def test_what_a_thief_has_taken_first_is_told_and_hides_nothing_else(story: Story) -> None:
    """Who is faster has the visit: the wallet says so, by what the chain proves, and goes on with the others."""
    wallet = story.open()
    mine, other = await wallet.scan()
    thief = Patient("thief", keys=derive_keys(draw_words()))
    _, arguments = story.hospital.transfer_arguments(mine.owner, thief, 7)
    await story.chain.call(wallet.owner_key(mine), "records", "transfer", arguments)
    assert [visit.owner for visit in await wallet.scan()] == [other.owner]
    assert [visit.owner for visit in wallet.store.content.visits if visit.taken] == [mine.owner]
    rotating = await rotate(wallet)
    done = await rotating.transfer_all(0.0, no_words)
    assert (done.done, [visit.owner for visit in done.taken]) == ((), [mine.owner])
    assert story.current(other) != other.owner


async def test_a_thief_who_comes_in_between_ends_nothing(story: Story) -> None:
    wallet = story.open()
    visits = await wallet.scan()
    old = {visit.owner: wallet.owner_key(visit) for visit in visits}
    thief = Patient("thief", keys=derive_keys(draw_words()))
    await take_new_words(wallet)
    waited: list[float] = []

    async def steal(pause_s: float) -> None:
        """While the wallet waits before the second visit, the thief takes it."""
        waited.append(pause_s)
        for number, visit in enumerate(visits):
            if len(waited) == 2 and story.current(visit) == visit.owner:
                arguments = story.hospital.transfer_arguments(visit.owner, thief, number)[1]
                story.hospital.must(old[visit.owner], "records", "transfer", *arguments)

    done = await KeyRotation(wallet, sleep=steal).transfer_all(600.0, no_words)
    assert (len(done.done), len(done.taken), done.refusal) == (1, 1, None)
    assert 0 <= sum(waited) <= 600
    assert min(waited) >= 0


async def test_a_refusal_ends_it_and_says_what_is_done(story: Story) -> None:
    wallet = story.open()
    rotating = await take_new_words(wallet)
    real, count = story.chain.call, 0

    async def fail_second(*arguments: object) -> object:
        nonlocal count
        count += 1
        if count == 2:
            raise BlockRobotError("NODE_UNREACHABLE")
        return await real(*arguments)  # type: ignore[arg-type]

    story.chain.call = fail_second  # type: ignore[method-assign,assignment]
    done = await rotating.transfer_all(0.0, no_words)
    assert (len(done.done), done.refusal is not None) == (1, True)
    assert len(await rotating.exposed_visits()) == 1
    assert story.open().store.content.transfers_due
    assert (await rotating.transfer_all(0.0, no_words)).refusal is None
    assert not story.open().store.content.transfers_due


async def test_who_leaves_keeps_what_was_recorded_of_her(story: Story) -> None:
    wallet = story.open()
    height = await KeyRotation(wallet).leave()
    assert height == story.hospital.height
    again = story.open()
    assert [len(report.records) for report in await again.records()] == [2, 2]
    assert await KeyRotation(again).leave() == 0
    assert story.hospital.view("identity", "member", story.person.identity.public_key)["status"] == "left"


async def test_leaving_can_be_cut_off_too(tmp_path: Path) -> None:
    cut_at = 0
    while True:
        folder = tmp_path / str(cut_at)
        folder.mkdir()
        story = Story(folder, OLD_WORDS)
        story.visit(1)
        story.power.cut_at = cut_at
        story.power.moments = 0
        try:
            await KeyRotation(story.open()).leave()
        except PowerCut:
            await KeyRotation(story.open()).leave()
        else:
            break
        assert len(await story.open().records()) == 1
        cut_at += 1
    assert cut_at >= 5


async def test_nobody_leaves_with_half_changed_words(story: Story) -> None:
    rotating = KeyRotation(story.open())
    rotating.prepare()
    assert await refusal(rotating.leave()) == "WALLET_ROTATION_OPEN"


def test_a_wallet_from_before_words_could_be_changed_opens() -> None:
    visit = {"owner": b"o", "ephemeral": b"r", "robot": b"b", "sequence": 3, "bucket_ms": 0}
    data = msgspec.msgpack.encode({"words": OLD_WORDS, "visits": [visit], "scanned_count": 4})
    content = msgspec.msgpack.decode(data, type=WalletContent)
    assert (content.former, content.next_words, content.left) == ([], "", False)
    assert (content.visits[0].current, content.visits[0].era, content.visits[0].taken) == (b"", 0, False)
