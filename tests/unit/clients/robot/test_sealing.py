"""Sealing: what a robot makes of a clip, its owner opens, checks and chains; nobody else opens anything."""

from __future__ import annotations

import secrets

import pytest
from nacl.public import PrivateKey as SealingPrivateKey

from clients.robot.recording.sealing import ClipContent, VisitChain, compute_expiry, compute_time_bucket, seal_clip
from clients.robot.recording.spool import SpooledClip
from consensus.errors import BlockRobotError
from consensus.limits import RETENTION_DEFAULT_MS, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.primitives.encoding import decode
from consensus.records.clips import ClipDownload, FrameDownload, check_clip_download, check_clip_upload
from consensus.records.commitments import ciphertext_leaves, frame_commitment
from consensus.records.envelopes import open_data_key, open_frame, open_metadata
from consensus.records.metadata import RecordMetadata, check_metadata, find_chain_gaps
from consensus.records.renditions import Rendition, decode_rendition

OWNER = SealingPrivateKey(bytes([7] * 32))
STRANGER = SealingPrivateKey(bytes([8] * 32))
NOW_MS = 1_800_000_123_456


def rendition(sequence: int, size_bytes: int = 500) -> Rendition:
    return Rendition(
        version=1,
        captured_at_ms=NOW_MS - 1_000 + 33 * sequence,
        sequence=sequence,
        width=640,
        height=480,
        x=10,
        y=20,
        box_width=30,
        box_height=40,
        background_id=bytes(32),
        encoding="png16",
        pixels=secrets.token_bytes(size_bytes),
    )


def chain() -> VisitChain:
    return VisitChain(
        owner=b"\x02" * 33,
        ephemeral=b"\x03" * 33,
        view_tag=1,
        purpose="demo",
        bucket_ms=compute_time_bucket(NOW_MS),
        sealing=bytes(OWNER.public_key),
    )


def sealed(renditions: list[Rendition], visit: VisitChain, withheld: tuple[tuple[str, int], ...] = ()) -> SpooledClip:
    content = ClipContent(renditions=tuple(renditions), withheld=withheld, sensor="depth", decided_at_ms=NOW_MS)
    return seal_clip(content, visit, now_ms=NOW_MS)


def metadata_of(clip: SpooledClip) -> RecordMetadata:
    return decode(open_metadata(bytes(OWNER), clip.sealed_metadata), RecordMetadata)


def test_the_owner_opens_every_picture_exactly_as_it_was() -> None:
    pictures = [rendition(number) for number in range(5)]
    clip = sealed(pictures, chain())
    opened = []
    for index, (text, key) in enumerate(zip(clip.upload.ciphertexts, clip.upload.sealed_keys, strict=True)):
        data_key = open_data_key(bytes(OWNER), key)
        plaintext = open_frame(data_key, clip.upload.record_id, index, text)
        assert frame_commitment(data_key, index, plaintext) == clip.upload.commitment_leaves[index]
        opened.append(decode_rendition(plaintext))
    assert opened == pictures


def test_every_frame_has_a_key_that_nobody_else_opens_and_no_picture_leaves_the_robot() -> None:
    clip = sealed([rendition(0)], chain())
    for open_it, data in ((open_data_key, clip.upload.sealed_keys[0]), (open_metadata, clip.sealed_metadata)):
        with pytest.raises(BlockRobotError, match=r"^ENVELOPE_INVALID:"):
            open_it(bytes(STRANGER), data)
    picture = rendition(0)
    assert picture.pixels[:32] not in sealed([picture], chain()).upload.ciphertexts[0]
    clip = sealed([rendition(number) for number in range(4)], chain())
    assert len({open_data_key(bytes(OWNER), key) for key in clip.upload.sealed_keys}) == 4


def test_frames_cannot_change_places_or_records() -> None:
    first, second = sealed([rendition(0), rendition(1)], chain()), sealed([rendition(0)], chain())
    data_key = open_data_key(bytes(OWNER), first.upload.sealed_keys[0])
    text = first.upload.ciphertexts[0]
    assert open_frame(data_key, first.upload.record_id, 0, text)
    for record_id, index in ((first.upload.record_id, 1), (second.upload.record_id, 0)):
        with pytest.raises(BlockRobotError):
            open_frame(data_key, record_id, index, text)


def test_the_upload_passes_the_custodians_check_and_leads_to_both_roots() -> None:
    clip = sealed([rendition(number) for number in range(3)], chain())
    check_clip_upload(clip.upload)
    upload = clip.upload
    frames = [
        FrameDownload(index, erased=False, ciphertext=text, sealed_key=key)
        for index, (text, key) in enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True))
    ]
    leaves = ciphertext_leaves(upload.ciphertexts, upload.sealed_keys)
    download = ClipDownload(upload.record_id, upload.txid, frames, upload.commitment_leaves, leaves)
    assert check_clip_download(download, clip.commitment_root, clip.ciphertext_root) == []


def test_the_records_of_a_visit_are_chained_so_that_a_gap_or_an_exchange_shows() -> None:
    visit = chain()
    metas = [metadata_of(sealed([rendition(number)], visit)) for number in range(4)]
    assert [meta.index_in_visit for meta in metas] == [0, 1, 2, 3]
    assert find_chain_gaps(metas) == []
    assert find_chain_gaps([metas[0], metas[2], metas[3]]) == [1]
    assert visit.record_count == 4
    visit, other = chain(), chain()
    metas = [metadata_of(sealed([rendition(number)], visit)) for number in range(3)]
    sealed([rendition(8)], other)
    forged = metadata_of(sealed([rendition(9)], other))
    assert forged.index_in_visit == 1
    assert find_chain_gaps([metas[0], forged, metas[2]]) != []


def test_metadata_tells_the_owner_what_was_recorded_and_withheld() -> None:
    pictures = [rendition(number) for number in range(3)]
    meta = metadata_of(sealed(pictures, chain(), (("contact", 2),)))
    check_metadata(meta)
    assert (meta.sensor, meta.frame_count, meta.width, meta.height) == ("depth", 3, 640, 480)
    assert (meta.started_at_ms, meta.ended_at_ms) == (pictures[0].captured_at_ms, pictures[-1].captured_at_ms)
    assert meta.withheld == (("contact", 2),)


def test_sizes_names_and_metadata_of_records_do_not_link() -> None:
    short = sealed([rendition(0)], chain())
    long = sealed([rendition(0)], chain(), tuple((f"reason-{number}", 10**6) for number in range(8)))
    assert len(short.sealed_metadata) == len(long.sealed_metadata) == SEALED_METADATA_BYTES
    sizes = {len(sealed([rendition(0, size)], chain()).upload.ciphertexts[0]) for size in range(5_000, 5_050)}
    assert len(sizes) == 1
    assert len({sealed([rendition(0)], chain()).upload.record_id for _ in range(8)}) == 8


def test_what_the_chain_learns_of_time_is_a_bucket_and_an_expiry_that_tells_no_more() -> None:
    clip = sealed([rendition(0)], chain())
    assert clip.bucket_ms % TIME_BUCKET_MS == 0
    assert 0 <= NOW_MS - clip.bucket_ms < TIME_BUCKET_MS
    assert abs(clip.expires_at_ms - NOW_MS - RETENTION_DEFAULT_MS) <= TIME_BUCKET_MS
    # `expires_at` stands in the clear beside the bucket: were it exact, so would be the time of the recording.
    assert sealed([rendition(0)], chain()).expires_at_ms % TIME_BUCKET_MS == 0


@pytest.mark.parametrize("retention_ms", [1, 1_000, TIME_BUCKET_MS, RETENTION_DEFAULT_MS])
def test_no_record_is_expired_when_it_is_made(retention_ms: int) -> None:
    expiries = [compute_expiry(NOW_MS + step, retention_ms) - NOW_MS - step for step in range(0, TIME_BUCKET_MS, 997)]
    assert min(expiries) > 0
    assert max(expiries) <= max(retention_ms, TIME_BUCKET_MS)
