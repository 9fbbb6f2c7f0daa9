"""A snapshot brings a new node to a block's state, and is believed only as far as genesis proves it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from consensus.chain.block import EpochProof, FinalityProof, genesis_certificate
from consensus.chain.epoch_settings import ChainSettings, Epoch
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from contracts.state.trie import compute_root
from node.snapshot import making, snapshot_format
from node.snapshot.checking import restore_into
from node.snapshot.making import describe_manifest, header_of_block, make_snapshot, make_snapshot_folder
from node.snapshot.restoring import WHOLE_MARK, adopt_restored, restore_ledger
from node.snapshot.snapshot_format import (
    CHUNK_SIZE_MAX_BYTES,
    FORMAT_LINE,
    MANIFEST_NAME,
    Manifest,
    MemorySnapshotFolder,
    RecentChunk,
    SnapshotFolder,
    StateChunk,
    chunk_name,
    compute_content_id,
    read_manifest,
    write_manifest,
)
from node.storage.ledger_store import REPLAY_WINDOW_KEPT_MS, LedgerStore, TransactionLocation
from node.storage.lmdb_reader import LedgerFile
from node.storage.lmdb_restore import LmdbRestore
from node.storage.lmdb_store import LmdbStore
from node.storage.memory_store import MemoryRestore, MemoryStore
from tests.unit.node.hand_made_chain import KEYS
from tests.unit.node.written_chain import WrittenChain


async def filled(chain: WrittenChain) -> MemoryStore:
    store = MemoryStore()
    await chain.fill(store)
    return store


async def snapshot_of(chain: WrittenChain) -> MemorySnapshotFolder:
    folder = MemorySnapshotFolder()
    with (await filled(chain)).snapshot() as ledger:
        make_snapshot(ledger, folder)
    return folder


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def written(blocks: int = 12) -> WrittenChain:
    chain = WrittenChain()
    for _ in range(blocks):
        chain.extend()
    return chain


def refusal(folder: MemorySnapshotFolder, chain: WrittenChain) -> str:
    """Return the code by which a snapshot is refused, or nothing if it is taken."""
    restore = MemoryRestore()
    try:
        restore_into(folder, chain.genesis, restore)
    except BlockRobotError as error:
        assert restore.store is None
        return error.code
    return ""


def tampered(folder: MemorySnapshotFolder, **changes: Any) -> MemorySnapshotFolder:
    """The same snapshot with another manifest, hashed anew: what a liar can make."""
    other = MemorySnapshotFolder()
    other.chunks = dict(folder.chunks)
    other.put_manifest(write_manifest(msgspec.structs.replace(read_manifest(folder.manifest()), **changes)))
    return other


def rewritten(folder: MemorySnapshotFolder, index: int, change: Callable[[Any], Any]) -> MemorySnapshotFolder:
    """The same snapshot with one chunk changed, and the manifest made to fit."""
    manifest = read_manifest(folder.manifest())
    kind = RecentChunk if index < manifest.recent_chunk_count else StateChunk
    data = encode(change(decode(folder.chunk(index), kind)))
    hashes = list(manifest.chunks)
    size = manifest.size_bytes + len(data) - len(folder.chunk(index))
    hashes[index] = sha256(data)
    other = tampered(folder, chunks=tuple(hashes), size_bytes=size)
    other.chunks[index] = data
    return other


@pytest.fixture(params=["lmdb", "memory"])
def restored(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Callable[[MemorySnapshotFolder, WrittenChain], LedgerStore]:
    """Restores a snapshot into a new store of either kind."""

    def restore(folder: MemorySnapshotFolder, chain: WrittenChain) -> LedgerStore:
        if request.param == "memory":
            memory = MemoryRestore()
            restore_into(folder, chain.genesis, memory)
            assert memory.store is not None
            return memory.store
        restore_into(folder, chain.genesis, LmdbRestore(tmp_path / "ledger"))
        return LmdbStore.open(tmp_path / "ledger")

    return restore


async def test_a_restored_ledger_holds_the_state_the_head_and_the_replay_window(restored) -> None:
    chain = written()
    store = restored(await snapshot_of(chain), chain)
    newest = chain.stored[-1]
    assert store.position == newest.position
    with store.snapshot() as view:
        assert list(view.scan(b"", 10_000)) == list(chain.state.scan(b"", 10_000))
        assert compute_root(view.scan(b"", 10_000)) == view.state_root == newest.state_root
        assert all(view.page(path) == page for path, page in chain.state.pages.items())
        assert (view.block(12), view.receipts(12)) == (newest.block_bytes, newest.receipts_bytes)
        assert view.finality == encode(chain.proof())
        assert view.earliest_height == 12
        assert view.block(11) is None
        assert view.kept_header(11) == chain.blocks[11].header_bytes
        assert view.block_height(chain.genesis.block_id) == 0
        assert view.locate(chain.stored[5].transactions[0][0]) == TransactionLocation(5, 0)
        recent = {item.txid: item for item in view.recent_txids(0)}
        for block in chain.stored:
            for txid, valid_until_ms in block.transactions:
                assert (recent[txid].height, recent[txid].valid_until_ms) == (block.height, valid_until_ms)
    await store.close()


async def test_a_restored_ledger_goes_on_and_can_be_made_a_snapshot_of(restored) -> None:
    chain = written(6)
    store = restored(await snapshot_of(chain), chain)
    for _ in range(5):
        chain.extend()
    await chain.fill(store)
    again = MemorySnapshotFolder()
    with store.snapshot() as view:
        second = make_snapshot(view, again)
    first = read_manifest((await snapshot_of(chain)).manifest())
    assert compute_content_id(second) == compute_content_id(first)
    assert refusal(again, chain) == ""
    await store.close()


async def test_a_snapshot_of_a_pruned_ledger_is_the_same(tmp_path: Path) -> None:
    chain = written()
    folder = await snapshot_of(chain)
    store = await filled(chain)
    assert await store.prune(9, header_of_block) == 9
    pruned = MemorySnapshotFolder()
    with store.snapshot() as ledger:
        make_snapshot(ledger, pruned)
    assert pruned.manifest_bytes == folder.manifest_bytes
    assert pruned.chunks == folder.chunks


async def test_the_replay_window_is_ten_minutes_and_the_block_before() -> None:
    chain = WrittenChain()
    for _ in range(9):
        chain.extend(later_ms=100_000)
    folder = await snapshot_of(chain)
    first = decode(folder.chunk(0), RecentChunk).blocks
    assert [row.header_bytes for row in first] == [block.header_bytes for block in chain.blocks[3:]]
    assert refusal(folder, chain) == ""
    short = rewritten(folder, 0, lambda chunk: RecentChunk(chunk.blocks[1:]))
    assert refusal(short, chain) == "SNAPSHOT_DAMAGED"


@pytest.mark.parametrize("pauses", [1, 2])
@pytest.mark.parametrize("kind", ["lmdb", "memory"])
async def test_a_snapshot_made_soon_after_a_long_pause_is_taken(tmp_path: Path, kind: str, pauses: int) -> None:
    """The block before the pause is long past every replay, and yet what shows that nothing is missing since."""
    chain = written(6)
    store: LedgerStore = LmdbStore.create(tmp_path / "ledger") if kind == "lmdb" else MemoryStore()
    await chain.fill(store)
    for _ in range(pauses):
        chain.extend(later_ms=10 * REPLAY_WINDOW_KEPT_MS)
        await chain.fill(store)
    folder = MemorySnapshotFolder()
    with store.snapshot() as ledger:
        make_snapshot(ledger, folder)
        assert [block.height for block in ledger.iter_recent(0)] == [len(chain.blocks) - 2, len(chain.blocks) - 1]
    await store.close()
    assert refusal(folder, chain) == ""


async def test_a_large_state_is_cut_into_chunks(monkeypatch, restored) -> None:
    monkeypatch.setattr(making, "CHUNK_SIZE_BYTES", 500)
    monkeypatch.setattr(snapshot_format, "CHUNK_SIZE_MEAN_MIN_BYTES", 500 // 8)
    chain = written(30)
    folder = await snapshot_of(chain)
    manifest = read_manifest(folder.manifest())
    assert manifest.recent_chunk_count > 3
    assert len(manifest.chunks) - manifest.recent_chunk_count > 5
    store = restored(folder, chain)
    assert store.position == chain.stored[-1].position
    await store.close()


@pytest.mark.parametrize("sizes", [(1,), (1, making.CHUNK_SIZE_BYTES - 1), (100_000, 1, 700_000)])
def test_no_state_is_cut_into_more_chunks_than_a_manifest_may_name(sizes: tuple[int, ...]) -> None:
    values = [bytes(size) for _ in range(3 * making.CHUNK_SIZE_BYTES // (sum(sizes) + 17) + 3) for size in sizes]
    cut = list(making._cut(iter([(b"k", value) for value in values]), making._state_size))
    size = sum(len(encode(StateChunk(rows))) for rows in cut)
    assert len(cut) >= 3
    manifest = Manifest(bytes(32), 1, b"", b"", b"", (), 1, 1, 0, size, (bytes(32),) * (1 + len(cut)))
    assert read_manifest(write_manifest(manifest)) == manifest


async def test_a_snapshot_of_an_empty_ledger_is_one_of_genesis(restored) -> None:
    chain = WrittenChain()
    store = restored(await snapshot_of(chain), chain)
    assert store.position == chain.stored[0].position
    await store.close()


async def test_a_snapshot_is_followed_over_epochs() -> None:
    chain = written(3)
    producers = tuple(key.public_key for key in KEYS[:3])
    chain.extend(next_epoch=Epoch(1, producers, (), ChainSettings()))
    chain.extend()
    chain.extend()
    chain.extend(next_epoch=Epoch(2, tuple(key.public_key for key in KEYS), (2,), ChainSettings(base_timeout_ms=900)))
    chain.extend()
    folder = await snapshot_of(chain)
    assert refusal(folder, chain) == ""
    manifest = read_manifest(folder.manifest())
    assert describe_manifest(manifest)["epochs_proved"] == [1, 2]
    assert refusal(tampered(folder, epoch_proofs=manifest.epoch_proofs[:1]), chain) == "SNAPSHOT_UNPROVEN"
    assert refusal(tampered(folder, epoch_proofs=manifest.epoch_proofs[::-1]), chain) == "SNAPSHOT_UNPROVEN"
    assert refusal(tampered(folder, epoch_proofs=()), chain) == "SNAPSHOT_UNPROVEN"


def boundary_chain() -> WrittenChain:
    """A chain whose newest block is a boundary: all that a ledger knows of the next epoch is its proof."""
    chain = written(3)
    chain.extend(next_epoch=Epoch(1, tuple(key.public_key for key in KEYS), (), ChainSettings()))
    return chain


def own_epoch(number: int) -> bytes:
    """A proof that proves nothing, for an epoch that a liar would rule alone."""
    mine = Epoch(number, (PrivateKey(sha256(b"liar")).public_key,), (), ChainSettings())
    return encode(EpochProof(FinalityProof(b"x", b"", genesis_certificate(bytes(32))), mine))


@pytest.mark.parametrize("number", [0, 1, 2])
async def test_an_epoch_that_only_a_liar_names_is_refused(number: int) -> None:
    """Behind a boundary a node follows the schedule of the last proof: it has to be the boundary's own."""
    chain = boundary_chain()
    folder = await snapshot_of(chain)
    proofs = read_manifest(folder.manifest()).epoch_proofs
    assert refusal(folder, chain) == ""
    assert refusal(tampered(folder, epoch_proofs=(own_epoch(number),)), chain) == "SNAPSHOT_UNPROVEN"
    assert refusal(tampered(folder, epoch_proofs=(*proofs, own_epoch(number))), chain) == "SNAPSHOT_UNPROVEN"
    chain.extend()
    later = await snapshot_of(chain)
    assert refusal(tampered(later, epoch_proofs=(*proofs, own_epoch(number))), chain) == "SNAPSHOT_UNPROVEN"
    begun = WrittenChain()
    first = await snapshot_of(begun)
    assert refusal(tampered(first, epoch_proofs=(own_epoch(number),)), begun) == "SNAPSHOT_UNPROVEN"


async def test_a_boundary_needs_the_proof_of_the_epoch_that_it_begins_and_a_good_one() -> None:
    chain = boundary_chain()
    folder = await snapshot_of(chain)
    proof = read_manifest(folder.manifest()).epoch_proofs[0]
    assert refusal(tampered(folder, epoch_proofs=()), chain) == "SNAPSHOT_UNPROVEN"
    assert refusal(tampered(folder, epoch_proofs=(proof, proof)), chain) == "SNAPSHOT_UNPROVEN"
    proof = decode(read_manifest(folder.manifest()).finality, FinalityProof)
    hollow = msgspec.structs.replace(proof, child_qc=genesis_certificate(bytes(32)))
    assert refusal(tampered(folder, finality=encode(hollow)), chain) == "SNAPSHOT_UNPROVEN"


async def test_a_head_that_its_producer_did_not_sign_is_refused() -> None:
    chain = written(3)
    other = msgspec.structs.replace(chain.blocks[-1], signature=chain.blocks[-2].signature)
    assert refusal(tampered(await snapshot_of(chain), block=encode(other)), chain) == "SNAPSHOT_DAMAGED"


async def test_two_snapshots_of_the_same_content_differ_in_certificates_only() -> None:
    """Whatever else a liar changes makes another content: what is said of that one says nothing of the honest one."""
    chain = boundary_chain()
    chain.extend()
    manifest = read_manifest((await snapshot_of(chain)).manifest())
    content_id = compute_content_id(manifest)
    epoch_proof = decode(manifest.epoch_proofs[0], EpochProof)
    finality = msgspec.structs.replace(epoch_proof.finality, child_qc=genesis_certificate(bytes(32)))
    recertified = encode(msgspec.structs.replace(epoch_proof, finality=finality))
    same = msgspec.structs.replace(manifest, epoch_proofs=(recertified,), finality=b"another quorum's")
    assert compute_content_id(same) == content_id
    for changes in (
        {"size_bytes": manifest.size_bytes + 1},
        {"height": manifest.height + 1},
        {"receipts": b""},
        {"block": chain.stored[1].block_bytes},
        {"state_row_count": manifest.state_row_count + 1},
        {"recent_block_count": manifest.recent_block_count + 1},
        {"recent_chunk_count": manifest.recent_chunk_count + 1},
        {"chunks": manifest.chunks[::-1]},
        {"epoch_proofs": ()},
        {"epoch_proofs": (own_epoch(1),)},
    ):
        assert compute_content_id(msgspec.structs.replace(manifest, **changes)) != content_id, changes


TINY_CHUNKS = {"chunks": (sha256(b"x"),) * snapshot_format.CHUNKS_MAX_COUNT, "size_bytes": 150_000}


async def test_a_manifest_that_contradicts_itself_or_holds_more_than_its_chunks_is_damaged() -> None:
    chain = written(3)
    folder = await snapshot_of(chain)
    chunks = len(read_manifest(folder.manifest()).chunks)
    with pytest.raises(BlockRobotError, match=r"^SNAPSHOT_DAMAGED:"):
        tampered(tampered(folder, size_bytes=chunks * CHUNK_SIZE_MAX_BYTES + 1), height=3)
    manifest = Manifest(bytes(32), 1, b"", b"", b"", (), 1, 1, 0, 5, (bytes(32),))
    for changes in (
        {"height": -1},
        {"recent_chunk_count": 2},
        {"recent_chunk_count": 0},
        {"chunks": (b"short",)},
        TINY_CHUNKS,
    ):
        with pytest.raises(BlockRobotError, match=r"^SNAPSHOT_DAMAGED:"):
            read_manifest(write_manifest(msgspec.structs.replace(manifest, **changes)))


async def test_what_a_liar_changes_is_refused() -> None:
    chain = written()
    folder = await snapshot_of(chain)
    manifest = read_manifest(folder.manifest())
    last = len(manifest.chunks) - 1

    def other_value(chunk: StateChunk) -> StateChunk:
        return StateChunk(((chunk.rows[0][0], b"mine"), *chunk.rows[1:]))

    def less_state(chunk: StateChunk) -> StateChunk:
        return StateChunk(chunk.rows[1:])

    def disorder(chunk: StateChunk) -> StateChunk:
        return StateChunk(chunk.rows[::-1])

    def no_txid(chunk: RecentChunk) -> RecentChunk:
        changed = msgspec.structs.replace(chunk.blocks[4], transactions=())
        return RecentChunk((*chunk.blocks[:4], changed, *chunk.blocks[5:]))

    def late_expiry(chunk: RecentChunk) -> RecentChunk:
        txid, valid_until_ms = chunk.blocks[4].transactions[0]
        changed = msgspec.structs.replace(chunk.blocks[4], transactions=((txid, valid_until_ms + 3_600_000),))
        return RecentChunk((*chunk.blocks[:4], changed, *chunk.blocks[5:]))

    def gap(chunk: RecentChunk) -> RecentChunk:
        return RecentChunk((*chunk.blocks[:4], *chunk.blocks[5:]))

    for index, change in (
        (last, other_value),
        (last, less_state),
        (last, disorder),
        (0, no_txid),
        (0, late_expiry),
        (0, gap),
        (0, lambda chunk: RecentChunk(chunk.blocks[:-1])),
    ):
        assert refusal(rewritten(folder, index, change), chain) == "SNAPSHOT_DAMAGED"
    assert refusal(tampered(folder, height=11), chain) == "SNAPSHOT_DAMAGED"
    assert refusal(tampered(folder, state_row_count=1), chain) == "SNAPSHOT_DAMAGED"
    assert refusal(tampered(folder, recent_block_count=1), chain) == "SNAPSHOT_DAMAGED"
    assert refusal(tampered(folder, block=chain.stored[11].block_bytes), chain) == "SNAPSHOT_UNPROVEN"
    assert refusal(tampered(folder, finality=b""), chain) == "SNAPSHOT_UNPROVEN"
    assert refusal(tampered(folder, receipts=chain.stored[0].receipts_bytes), chain) == "SNAPSHOT_DAMAGED"
    bare = msgspec.structs.replace(chain.blocks[-1], transactions=())
    assert refusal(tampered(folder, block=encode(bare)), chain) == "SNAPSHOT_DAMAGED"
    begun = tampered(folder, block=chain.stored[0].block_bytes, height=0)
    assert refusal(begun, chain) == "SNAPSHOT_UNPROVEN"
    assert refusal(tampered(begun, finality=b""), chain) == "SNAPSHOT_DAMAGED"


async def test_a_snapshot_of_another_chain_or_format_is_refused_by_name() -> None:
    chain = written(3)
    folder = await snapshot_of(chain)
    assert (
        refusal(folder, WrittenChain(msgspec.structs.replace(chain.genesis, network="other"))) == "SNAPSHOT_OTHER_CHAIN"
    )
    data = folder.manifest()
    folder.put_manifest(data.replace(FORMAT_LINE, b"blockrobot-snapshot/9\n"))
    assert refusal(folder, chain) == "SNAPSHOT_VERSION"
    folder.put_manifest(b"something else")
    assert refusal(folder, chain) == "SNAPSHOT_DAMAGED"
    folder.manifest_bytes = None
    assert refusal(folder, chain) == "SNAPSHOT_TRUNCATED"


# Folders


async def test_a_folder_appears_whole_and_never_over_another(tmp_path: Path) -> None:
    chain = written(3)
    store = await filled(chain)
    seen: list[tuple[int, int]] = []
    mine = tmp_path / "snap.unfinished"
    mine.mkdir()
    (mine / "thesis.txt").touch()
    with store.snapshot() as ledger:
        manifest = make_snapshot_folder(ledger, tmp_path / "snap", lambda *done: seen.append(done))
        assert names_in(tmp_path) == ["snap", "snap.unfinished"]
        assert names_in(mine) == ["thesis.txt"], "whatever the name of a neighbour is, it is somebody's"
        assert seen[-1] == (len(manifest.chunks), manifest.size_bytes)
        with pytest.raises(BlockRobotError, match=r"^FOLDER_NOT_EMPTY:"):
            make_snapshot_folder(ledger, tmp_path / "snap")
    assert read_manifest(SnapshotFolder(tmp_path / "snap").manifest()) == manifest


async def _folder(chain: WrittenChain, path: Path) -> SnapshotFolder:
    with (await filled(chain)).snapshot() as ledger:
        make_snapshot_folder(ledger, path)
    return SnapshotFolder(path)


async def test_a_node_s_ledger_is_replaced_by_a_newer_snapshot_only(tmp_path: Path) -> None:
    chain = written(3)
    ledger_dir = tmp_path / "ledger"
    store = LmdbStore.create(ledger_dir)
    await chain.fill(store)
    await store.close()
    old = await _folder(chain, tmp_path / "old")
    for _ in range(3):
        chain.extend()
    new = await _folder(chain, tmp_path / "new")
    with pytest.raises(BlockRobotError, match=r"^SNAPSHOT_OLD:"):
        restore_ledger(old, chain.genesis, ledger_dir)
    for index, code in ((0, "SNAPSHOT_DAMAGED"), (1, "SNAPSHOT_TRUNCATED")):
        chunk = tmp_path / "old" / chunk_name(index)
        whole = chunk.read_bytes()
        chunk.unlink()
        if code == "SNAPSHOT_DAMAGED":
            chunk.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        with pytest.raises(BlockRobotError) as damaged:
            restore_ledger(old, chain.genesis, ledger_dir)
        assert damaged.value.code == code, "that it is old as well is the smaller trouble"
        chunk.write_bytes(whole)
    assert restore_ledger(new, chain.genesis, ledger_dir).header.height == 6
    assert names_in(tmp_path) == ["ledger", "new", "old"]
    with LedgerFile(ledger_dir) as ledger, ledger.snapshot() as view:
        assert view.position == chain.stored[-1].position


@pytest.mark.parametrize("name", [chunk_name(0), chunk_name(1), MANIFEST_NAME])
async def test_a_truncated_snapshot_leaves_the_ledger_as_it_was(tmp_path: Path, name: str) -> None:
    chain = written(3)
    source = await _folder(chain, tmp_path / "snap")
    path = tmp_path / "snap" / name
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    with pytest.raises(BlockRobotError) as cut:
        restore_ledger(source, chain.genesis, tmp_path / "ledger")
    path.unlink()
    with pytest.raises(BlockRobotError) as gone:
        restore_ledger(source, chain.genesis, tmp_path / "ledger")
    assert (cut.value.code, gone.value.code) == ("SNAPSHOT_DAMAGED", "SNAPSHOT_TRUNCATED")
    assert names_in(tmp_path) == ["snap"]


async def test_a_restore_that_a_crash_cut_off_is_finished_or_cleared_away(tmp_path: Path) -> None:
    """Whatever moment the crash chose: the old ledger or the new one is there, whole."""
    chain = written(3)
    source = await _folder(chain, tmp_path / "snap")
    ledger_dir, incoming, replaced = (tmp_path / name for name in ("ledger", "ledger.incoming", "ledger.replaced"))
    ledger_dir.mkdir()
    (ledger_dir / "old").touch()

    restore_into(source, chain.genesis, LmdbRestore(incoming))
    adopt_restored(ledger_dir)
    assert (ledger_dir / "old").exists()
    assert not incoming.exists()

    restore_into(source, chain.genesis, LmdbRestore(incoming))
    (incoming / WHOLE_MARK).touch()
    ledger_dir.rename(replaced)
    adopt_restored(ledger_dir)
    assert not incoming.exists()
    assert not replaced.exists()
    with LedgerFile(ledger_dir) as ledger, ledger.snapshot() as view:
        assert view.position == chain.stored[-1].position
    assert not (ledger_dir / WHOLE_MARK).exists()


@pytest.mark.parametrize("ahead", [0, 2])
async def test_a_restored_ledger_that_is_not_newer_than_the_one_in_place_is_dropped(tmp_path: Path, ahead: int) -> None:
    """The node went on by blocks while the other was built, and it may have voted for them since."""
    chain = written(3)
    source = await _folder(chain, tmp_path / "snap")
    restore_into(source, chain.genesis, LmdbRestore(tmp_path / "ledger.incoming"))
    (tmp_path / "ledger.incoming" / WHOLE_MARK).touch()
    for _ in range(ahead):
        chain.extend()
    store = LmdbStore.create(tmp_path / "ledger")
    await chain.fill(store)
    await store.close()
    adopt_restored(tmp_path / "ledger")
    assert names_in(tmp_path) == ["ledger", "snap"]
    with LedgerFile(tmp_path / "ledger") as ledger, ledger.snapshot() as view:
        assert view.position == chain.stored[-1].position
        assert view.earliest_height == 0


async def test_a_ledger_is_read_while_its_node_writes_it(tmp_path: Path) -> None:
    chain = written(3)
    store = LmdbStore.create(tmp_path / "ledger")
    await chain.fill(store)
    with store.snapshot() as own:
        assert own.position == chain.stored[-1].position
    await store.close()
    with LedgerFile(tmp_path / "ledger") as ledger, ledger.snapshot() as view:
        folder = MemorySnapshotFolder()
        assert make_snapshot(view, folder).height == 3
    assert refusal(folder, chain) == ""
