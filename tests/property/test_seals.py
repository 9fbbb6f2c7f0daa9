"""Seals for whatever was found of a record: green, and verified on the chain, only if every check of it passed."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.page.record_seals import Seal, VerifiedBlock, page_seal
from clients.wallet.records.viewing import (
    CHECKS,
    CUSTODY_CHECKS,
    STATUS_CORRUPTED,
    STATUS_ERASED,
    STATUS_NOTICE,
    STATUS_OK,
    FrameView,
    RecordView,
)
from clients.wallet.store.keystore import KnownVisit
from consensus.limits import CLIP_FRAMES_MAX_COUNT
from consensus.records.metadata import RecordMetadata
from consensus.state.records import RecordRow

ROW = RecordRow(
    owner=bytes(33),
    robot=bytes(33),
    commitment_root=bytes(32),
    ciphertext_root=bytes(32),
    sealed_metadata=b"",
    bucket_ms=0,
    expires_at_ms=1,
    height=1,
    txid=bytes(32),
    status="active",
    erased_frames=[],
    awaited=[],
)

VISIT = KnownVisit(owner=b"\x02" * 33, ephemeral=bytes(33), robot=bytes(33), sequence=0, bucket_ms=0)
BLOCK = VerifiedBlock(7, 1_800_000_000_000, b"\x07" * 32)
statuses = st.lists(
    st.sampled_from([STATUS_OK, STATUS_NOTICE, STATUS_ERASED, STATUS_CORRUPTED]),
    min_size=1,
    max_size=CLIP_FRAMES_MAX_COUNT,
)
differences = st.one_of(st.just(0), st.integers(-CLIP_FRAMES_MAX_COUNT, CLIP_FRAMES_MAX_COUNT))


def found(frames: list[str], counted: int, failed: str = CHECKS[0]) -> RecordView:
    metadata = RecordMetadata("depth", 1, 2, counted, 0, bytes(32), (), 64, 48)
    views = tuple(
        FrameView(index, status, None, failed=failed if status == STATUS_CORRUPTED else "")
        for index, status in enumerate(frames)
    )
    return RecordView(RecordEntry(bytes(16), VISIT, ROW, metadata), views, ("node-1",))


@given(frames=statuses, difference=differences, language=st.sampled_from(["en", "pt"]))
def test_a_seal_is_good_and_a_verdict_verified_only_if_every_check_passed(
    frames: list[str], difference: int, language: str
) -> None:
    counted = min(CLIP_FRAMES_MAX_COUNT, max(1, len(frames) + difference))
    view = found(frames, counted)
    seal = page_seal(Seal(view, BLOCK, 0), language)
    is_sound = STATUS_CORRUPTED not in frames and counted == len(frames)
    assert (seal.state == "good") == all(check.ok for check in seal.checks) == is_sound
    assert (view.verdict == "verified") == is_sound
    assert all(0 <= place < len(frames) for place in view.corrupted), "a verdict names what is there"
    assert view.corrupted == sorted(set(view.corrupted))


@given(frames=statuses.filter(lambda each: STATUS_CORRUPTED in each), check=st.sampled_from(CHECKS))
def test_a_seal_says_which_check_failed_and_nothing_of_those_that_come_after_it(frames: list[str], check: str) -> None:
    seal = page_seal(Seal(found(frames, len(frames), check), BLOCK, 0), "en")
    told = {each.code: each.ok for each in seal.checks}
    passed = ("header_votes", "record_on_chain", *CHECKS[: CHECKS.index(check)])
    assert told == dict.fromkeys(passed, True) | {check: False, "complete": True}
    assert seal.damaged == (seal.corrupted if check in CUSTODY_CHECKS else [])


@given(frames=statuses.filter(lambda each: STATUS_CORRUPTED not in each), data=st.data())
def test_no_erasure_of_pictures_turns_a_good_seal_red(frames: list[str], data: st.DataObject) -> None:
    gone = data.draw(st.sets(st.integers(0, len(frames) - 1)))
    after = [STATUS_ERASED if index in gone else status for index, status in enumerate(frames)]
    assert [page_seal(Seal(found(each, len(frames)), BLOCK, 0), "en").state for each in (frames, after)] == ["good"] * 2
