"""No erase key is in a node's memory: not once a clip is kept, not after it was handed out, not after it was erased."""

from __future__ import annotations

import asyncio
import os
import re
from pathlib import Path

import pytest

from network.custody.custody_requests import ask_status
from node.custody.erase_keys import ERASE_KEY_BYTES, HEADER_BYTES, PAGE_SLOTS_COUNT
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import Intruder
from tests.security.ward import Ward

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.smoke]

CHUNK_BYTES = 8 * 1024 * 1024


def _find_process(data_dir: Path) -> int:
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if b"node.main" in b" ".join(line) and os.fsencode(str(data_dir)) in line:
                return int(entry.name)
    raise AssertionError(f"no process of {data_dir}")


def _search_memory(pid: int, wanted: list[bytes]) -> list[bytes]:
    """Return which of these are in a process's writable memory. Raises PermissionError if it may not be read."""
    found = set()
    with Path(f"/proc/{pid}/maps").open() as maps, Path(f"/proc/{pid}/mem").open("rb", buffering=0) as memory:
        for line in maps:
            start, end, mode = re.match(r"([0-9a-f]+)-([0-9a-f]+) (\S+)", line).groups()  # type: ignore[union-attr]
            if not mode.startswith("rw"):
                continue
            at, last, tail = int(start, 16), int(end, 16), b""
            while at < last:
                try:
                    memory.seek(at)
                    content = tail + memory.read(min(CHUNK_BYTES, last - at))
                except (OSError, ValueError, OverflowError):
                    break
                found.update(each for each in wanted if each in content)
                tail = content[-64:]
                at += CHUNK_BYTES
    return sorted(found)


def _held_keys(data_dir: Path) -> list[bytes]:
    content = (data_dir / "erase-keys" / "erase-keys").read_bytes()
    states = content[HEADER_BYTES : HEADER_BYTES + PAGE_SLOTS_COUNT]
    first = HEADER_BYTES + PAGE_SLOTS_COUNT
    slots = [slot for slot, state in enumerate(states) if state == 1]
    return [content[first + slot * ERASE_KEY_BYTES :][:ERASE_KEY_BYTES] for slot in slots]


async def test_no_erase_key_stays_in_a_nodes_memory(network: NetworkUnderTest, intruder: Intruder) -> None:
    ward = Ward(intruder)
    await ward.open()
    config = network.cluster.configs[intruder.node]
    clip = ward.clip(frames=8)
    for name in (node.name for node in intruder.genesis.nodes if node.custodian_key):
        token = await intruder.session(ward.robot.identity, name)
        assert (await ward.upload(clip.upload, name, token))[0] == 200
    assert (await intruder.final(ward.record_call(clip)))["ok"]
    keys = _held_keys(config.data_dir)
    assert len(keys) == 8
    access = await ward.must(ward.owner, "access", "request", [clip.upload.record_id], "own-access")
    owner = await intruder.session(ward.owner)
    path = f"/v1/clips/{clip.upload.record_id.hex()}?access_id={access.txid.hex()}"
    assert (await intruder.ask("GET", path, headers=owner))[0] == 200
    pid = _find_process(config.data_dir)
    if os.geteuid() != 0:  # the guard keeps this user out, as it should
        with pytest.raises(PermissionError):
            _search_memory(pid, keys)
        return
    control = await asyncio.to_thread(_search_memory, pid, [os.fsencode(str(config.data_dir))])
    assert control, "the search finds what is there"
    kept = await asyncio.to_thread(_search_memory, pid, keys)
    await ward.must(ward.owner, "erasure", "request", [clip.upload.record_id], [])
    for _ in range(400):
        if (await ask_status(config)).clips_erased:
            break
        await asyncio.sleep(0.05)
    assert _held_keys(config.data_dir) == []
    assert await asyncio.to_thread(_search_memory, pid, keys) == []
    assert kept == [], "nor is one there while its clip is kept"
