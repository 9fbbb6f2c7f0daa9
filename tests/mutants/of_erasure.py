"""What an erasure destroys, in which order, and when it is said to be done."""

from __future__ import annotations

from tests.mutants.mutant import Kind, Replaced

REPLACED: tuple[Replaced, ...] = (
    Replaced(
        Kind.ERASURE,
        "node/custody/erasure.py",
        "rows go, the keys of shared parts stay",
        (
            "        await asyncio.to_thread(self._keys.destroy, slots)\n        self._is_swept = False\n"
            "        await self._store.erase_parts(slots)"
        ),
        "        self._is_swept = False\n        await self._store.erase_parts(slots)",
        "tests/offchain/test_sharing_ends.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erasure.py",
        "what is erased again is not read back",
        (
            "        await self._read_back(parts)\n        await asyncio.to_thread(self._keys.release, slots)\n"
            "\n    async def forget"
        ),
        "        await asyncio.to_thread(self._keys.release, slots)\n\n    async def forget",
        "tests/offchain/test_erasing_again.py",
    ),
    Replaced(
        Kind.ERASURE,
        "contracts/privacy/erasure.py",
        "an erasure is complete while one custodian is missing",
        'if len(entry["receipts"]) == len(entry["custodians"]):',
        'if len(entry["receipts"]) >= len(entry["custodians"]) - 1:',
        "tests/unit/contracts/privacy/test_erasure.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erasure.py",
        "a receipt is owed before it was read back",
        "        await self._read_back(parts)\n        await self._store.mark_outbox_ready(row.key)\n",
        "        await self._store.mark_outbox_ready(row.key)\n        await self._read_back(parts)\n",
        "tests/offchain/test_erasing_again.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erasure.py",
        "rows are deleted before their keys are destroyed",
        (
            "        await asyncio.to_thread(self._keys.destroy, slots)\n        self._is_swept = False\n"
            "        for part in parts:\n            if part.whole:\n"
            "                await self._store.erase_clip(part.record_id)\n            else:\n"
            "                await self._store.erase_frames(part.record_id, part.indexes)\n"
        ),
        (
            "        self._is_swept = False\n        for part in parts:\n            if part.whole:\n"
            "                await self._store.erase_clip(part.record_id)\n            else:\n"
            "                await self._store.erase_frames(part.record_id, part.indexes)\n"
            "        await asyncio.to_thread(self._keys.destroy, slots)\n"
        ),
        "tests/offchain/test_erasing_again.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erasure.py",
        "the store's files are not swept",
        "            await self._store.sweep()\n",
        "",
        "tests/offchain/test_custodian.py::test_the_whole_store_is_looked_through_once_a_block_however_much_it_erases",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erasure.py",
        "keys of frames that were shared stay",
        "p for p in places if up_to_height is None or p.height <= up_to_height",
        "p for p in places if up_to_height is None",
        "tests/offchain/test_sharing_ends.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erasure.py",
        "a key in use is freed before its row is gone",
        (
            "        await self._store.drop_staged(record_id)\n"
            "        await self.destroy_unused([place.slot for place in places])\n"
        ),
        (
            "        await self.destroy_unused([place.slot for place in places])\n"
            "        await self._store.drop_staged(record_id)\n"
        ),
        "tests/offchain/test_erasing_again.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erase_keys.py",
        "an overwritten key is not read back",
        "                if self._read(self._key_offset(slot), ERASE_KEY_BYTES) != _ZEROS:\n",
        "                if False:\n",
        "tests/offchain/test_erase_keys.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erase_keys.py",
        "a destroyed key is not forced to the medium",
        "                self._put_state(slot, _DESTROYED)\n            self._sync()\n",
        "                self._put_state(slot, _DESTROYED)\n",
        "tests/offchain/test_erase_keys.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erase_keys.py",
        "a key is in use before it is on the medium",
        "                self._put_state(slot, _HELD)\n            self._sync()\n",
        "                self._put_state(slot, _HELD)\n",
        "tests/offchain/test_erase_keys.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/erase_keys.py",
        "a slot that holds a key is given out again",
        "if self._is_known(slot) and self._states[slot] == _DESTROYED})",
        "if self._is_known(slot) and self._states[slot] != _FREE})",
        "tests/offchain/test_erase_keys.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/custodian.py",
        "a block is closed before its plans are",
        ("        await self._eraser.finish()\n        await self._store.apply(BlockEffects(checkpoint=point))\n"),
        ("        await self._store.apply(BlockEffects(checkpoint=point))\n        await self._eraser.finish()\n"),
        "tests/offchain/test_erasing_again.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/custodian.py",
        "frames that were erased come back with a late upload",
        "        kept = [row for row in rows if row.index not in facts.erased_frames]\n        confirmed",
        "        kept = list(rows)\n        confirmed",
        "tests/offchain/test_late_uploads.py",
    ),
    Replaced(
        Kind.ERASURE,
        "node/custody/stores/sqlite_store.py",
        "an expired clip is kept a moment longer",
        "status = 'confirmed' AND expires_at_ms <= ? ORDER BY",
        "status = 'confirmed' AND expires_at_ms < ? ORDER BY",
        "tests/offchain/test_custodian.py tests/offchain/test_store_contract.py",
    ),
)
