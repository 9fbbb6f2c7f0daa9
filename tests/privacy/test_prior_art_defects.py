"""The thirteen defects of the published prototype, each as a test that this system does not have it.

The numbers are those of the published list; each test is named by the defect, and says in its first line what the
prototype did.
"""

from __future__ import annotations

import hashlib
import re
import stat
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from aiohttp.test_utils import TestClient, TestServer

from clients.registrar.registrar import Registrar
from clients.robot.hiding.frame_redactor import KeptFrame
from clients.robot.pairing.tag_pairing import MEMORY_MS, Pairing
from clients.robot.sensing.sensor_clocks import RunClocks
from clients.robot.sensing.sensor_events import Facing, Frame, Sighting
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import published_run_1
from clients.robot.synthetic.tag_readings import readings
from clients.wallet.store.keystore import Keystore
from consensus.errors import BlockRobotError
from consensus.members.vouchers import decode_card_code
from consensus.primitives.keys import PrivateKey
from node.api import create_api
from node.custody.custodian import Custodian
from node.custody.erase_keys import EraseKeys
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.house import refused
from tests.offchain.small_chain import (
    ALICE,
    CUSTODIAN,
    EXPIRES_MS,
    START_MS,
    SmallChain,
    access,
    erasure,
    record_clip,
    recorded,
)
from tests.unit.clients.robot.hiding.test_frame_redactor import OWNERS, Clip, pixels, play
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit, key_of
from tests.unit.node.api.small_network import RECORD_ID, SmallLedger, SmallNode
from tests.world.dicts import CHEAP

ROOT = Path(__file__).parents[2]
WORDS = " ".join(["abandon"] * 11 + ["about"])
UID_TRIES_COUNT = 20_000
KEY_SHAPES = re.compile(
    rb"-----BEGIN (?:[A-Z]+ )?PRIVATE KEY-----\s+[A-Za-z0-9+/=]{40}"
    rb"|\bPVT_[KR]1_\w{40}|\b5[HJK][1-9A-HJ-NP-Za-km-z]{49}\b|\bPW5\w{40}"
)


@asynccontextmanager
async def custodian_in(directory: Path, chain: SmallChain) -> AsyncIterator[Custodian]:
    async with SqliteStore(directory / "custody") as store:
        with EraseKeys(directory / "erase-keys") as keys:
            custodian = Custodian(store, keys, member=CUSTODIAN, clock_ms=lambda: chain.time_ms)
            await custodian.start()
            yield custodian


def all_bytes_in(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())


def _two_patients() -> tuple[Hospital, Person, Person, Visit, Visit]:
    hospital = Hospital()
    anna, ben = hospital.enrol("anna"), hospital.enrol("ben")
    of_anna, of_ben = hospital.open_visit(anna), hospital.open_visit(ben)
    for visit in (of_anna, of_ben):
        for _ in range(3):
            hospital.record(visit)
    return hospital, anna, ben, of_anna, of_ben


def _everyone(hospital: Hospital, *visits: Visit) -> list[PrivateKey]:
    return [
        key_of("stranger"),
        hospital.registrar,
        hospital.admin,
        hospital.robot.identity,
        *hospital.custodians,
        *(visit.key for visit in visits),
    ]


async def test_defect_01_pictures_in_plaintext(tmp_path: Path) -> None:
    """Encryption was a to-do. Here no picture, and no key that opens one, is in a custodian's files."""
    chain, clip = SmallChain(), record_clip()
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip)))
        written = all_bytes_in(tmp_path)
        assert clip.upload.ciphertexts[0][:64] in written
        for secret in (*clip.plaintexts, *clip.data_keys, *clip.upload.sealed_keys):
            assert secret not in written


def test_defect_02_anyone_wipes_everything() -> None:
    """`eraseall` needed no authorisation. Here nobody can erase everything, whoever he is."""
    hospital, _, _, of_anna, of_ben = _two_patients()
    everything = of_anna.records + of_ben.records
    for key in _everyone(hospital, of_anna, of_ben):
        assert not hospital.send(key, "erasure", "request", everything, []).ok
        assert not hospital.send(key, "erasure", "request", [], []).ok
        assert not hospital.send(key, "erasure", "eraseall").ok
        assert not hospital.send(key, "erasure", "expired", everything, bytes(32)).ok
        assert not hospital.send(key, "records", "complete_erasure", everything, []).ok
    for record_id in everything:
        assert hospital.view("records", "get", record_id)["status"] == "active"


def test_defect_03_anyone_deletes_any_user() -> None:
    """`erase` of the login contract needed no authorisation. Here it takes the member, or his organisation."""
    hospital, anna, ben, of_anna, of_ben = _two_patients()
    strangers = [key for key in _everyone(hospital, of_anna, of_ben) if key not in (hospital.registrar, hospital.admin)]
    for key in [*strangers, ben.identity]:
        assert not hospital.send(key, "identity", "leave", anna.handle).ok
        assert not hospital.send(key, "identity", "revoke", anna.handle).ok
    assert hospital.view("identity", "member", anna.identity.public_key)["status"] == "active"


def test_defect_04_any_patient_erases_anothers_data() -> None:
    """The record's tag hash was never compared with the caller. Here the record's owner key signs, or nothing happens."""
    hospital, _, ben, of_anna, of_ben = _two_patients()
    for key, code in ((of_ben.key, "NOT_THE_OWNER"), (ben.identity, "VISIT_UNKNOWN")):
        for frames in ([], [0]):
            receipt = hospital.send(key, "erasure", "request", of_anna.records[:1], frames)
            assert receipt.code == code
    assert hospital.view("records", "get", of_anna.records[0])["status"] == "active"
    assert hospital.view("records", "get", of_anna.records[0])["erased_frames"] == []


def test_defect_05_an_erasure_spins_on_a_foreign_row() -> None:
    """The loop never advanced past a row of somebody else. Here such an erasure ends at once, and cheaply."""
    hospital, _, _, of_anna, of_ben = _two_patients()
    mixed = [of_ben.records[0], of_anna.records[0], of_ben.records[1], of_ben.records[2]]
    receipt = hospital.send(of_ben.key, "erasure", "request", mixed, [])
    assert receipt.code == "NOT_THE_OWNER"
    assert receipt.gas_used < 10_000
    assert hospital.view("records", "get", of_ben.records[0])["status"] == "active"
    hospital.must(of_ben.key, "erasure", "request", of_ben.records, [])


@pytest.mark.parametrize("frames", [(0,), (5,), (0, 1, 2), (3, 4, 5), (0, 1, 2, 3, 4, 5)])
async def test_defect_06_the_first_frame_of_an_erased_range_stays(tmp_path: Path, frames: tuple[int, ...]) -> None:
    """The chain erased `>=`, the store `>`. Here both go by the same frames, and expiry by the same millisecond."""
    chain, clip = SmallChain(), record_clip(6)
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip), erasure(b"\x01" * 32, clip, frames=frames)))
        held = (await custodian.export(clip.record_id)).frames
        assert [frame.index for frame in held if frame.erased] == list(frames)
        await custodian.on_finalized_block(chain.block(at_ms=EXPIRES_MS - 1))
        held = (await custodian.export(clip.record_id)).frames
        assert [frame.index for frame in held if frame.erased] == list(frames)
        await custodian.on_finalized_block(chain.block(at_ms=EXPIRES_MS))
        await refused("CLIP_ERASED", custodian.export(clip.record_id))


async def test_defect_07_the_hook_acts_on_forks_and_replays_from_block_0(tmp_path: Path) -> None:
    """Its position was in memory. Here it is kept with the effects, and what is not the next block is refused whole."""
    chain, clip = SmallChain(), record_clip()
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip)))
        await custodian.on_finalized_block(chain.block())
        forked = replace(chain.block(erasure(b"\x01" * 32, clip)), height=2, block_id=b"\xff" * 32)
        await refused("CUSTODY_OUT_OF_ORDER", custodian.on_finalized_block(forked))
        assert not any(frame.erased for frame in (await custodian.export(clip.record_id)).frames)
        assert await custodian.ready_outbox(10) == []
        await custodian.on_finalized_block(chain.blocks[-1])
        owed = await custodian.ready_outbox(10)
        assert owed
    async with custodian_in(tmp_path, chain) as custodian:
        assert (await custodian.checkpoint()).height == 3
        for block in chain.blocks:
            await custodian.on_finalized_block(block)
        assert await custodian.ready_outbox(10) == owed
        assert await custodian.missing(10) == []


async def test_defect_08_the_clean_up_takes_milliseconds_for_seconds(tmp_path: Path) -> None:
    """It deleted every sighting. Here sightings live for as long as pairing needs them, uploads until they cannot count."""
    pairing = Pairing()
    pairing.add_sighting("tag", START_MS, START_MS)
    pairing.advance(START_MS + MEMORY_MS)
    late = pairing.add_frame(1, START_MS + pairing.window_ms) + pairing.flush()
    assert [decision.owners for decision in late] == [("tag",)]
    pairing.advance(START_MS + pairing.window_ms + MEMORY_MS + 1_000)
    assert pairing.owners_so_far(START_MS) == (), "and no longer"
    chain, clip = SmallChain(), record_clip(valid_until_ms=START_MS + 60_000)
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(at_ms=START_MS + 59_999))
        await custodian.on_finalized_block(chain.block(recorded(clip), at_ms=START_MS + 60_000))
        assert (await custodian.export(clip.record_id)).record_id == clip.record_id
        other = record_clip(valid_until_ms=START_MS + 60_001)
        await custodian.stage(other.upload)
        await custodian.on_finalized_block(chain.block(at_ms=START_MS + 60_002))
        await custodian.on_finalized_block(chain.block(recorded(other)))
        assert [facts.record_id for facts in await custodian.missing(10)] == [other.record_id]


async def test_defect_09_frames_without_a_login_and_without_the_patients_word(tmp_path: Path) -> None:
    """`GET /data` asked nobody, and the API signed afterwards. Here it takes a session, and her final word on the chain."""
    node = SmallNode.around(await SmallLedger().start())
    async with TestClient(TestServer(create_api(node.services))) as client:
        answer = await client.get(f"/v1/clips/{RECORD_ID.hex()}", params={"access_id": "0a" * 32})
        assert (answer.status, (await answer.json())["code"]) == (401, "SESSION_REQUIRED")
    chain, clip, access_id = SmallChain(), record_clip(), b"\x0a" * 32
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip)))
        request = chain.block(access(access_id, clip))
        await refused("ACCESS_NOT_GRANTED", custodian.download(clip.record_id, access_id, ALICE))
        await custodian.on_finalized_block(request)
        assert len((await custodian.download(clip.record_id, access_id, ALICE)).frames) == 3


def test_defect_10_private_keys_and_a_password_in_the_repository(tmp_path: Path) -> None:
    """Whoever read the source had the keys. Here no file has one, and a key file is its user's alone, and encrypted."""
    assert KEY_SHAPES.search(b"key = 5KQwrPbwdL6PhXujxW37FSSQZ1JiwsST4cqQzDeyXtP79zkvFD3"), "the search finds one"
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode()
    paths = [ROOT / name for name in names.split("\0") if name]
    assert len(paths) > 500
    found = [
        path for path in paths if path.is_file() and path != Path(__file__) and KEY_SHAPES.search(path.read_bytes())
    ]
    assert found == []
    assert [path for path in paths if path.suffix in {".key", ".wallet", ".p12", ".pfx"}] == []
    wallet = tmp_path / "ann.wallet"
    Keystore.create(wallet, WORDS, "tea", CHEAP)
    assert stat.S_IMODE(wallet.stat().st_mode) == 0o600
    assert b"abandon" not in wallet.read_bytes()
    with pytest.raises(BlockRobotError):
        Keystore.open(wallet, "coffee")


def test_defect_11_tag_hashes_that_a_second_of_searching_reverses(tmp_path: Path) -> None:
    """Unsalted SHA-256 of short numbers. Here nothing on the chain is a function of a tag's number."""
    hospital, uid = Hospital(), f"E280116060{12_345:06d}"
    tries = {
        hashlib.sha256(form).digest(): number
        for number in range(UID_TRIES_COUNT)
        for form in (f"E280116060{number:06d}".encode(), bytes.fromhex(f"E280116060{number:06d}"))
    }
    assert tries[hashlib.sha256(uid.encode()).digest()] == 12_345, "the prototype's would be found"
    (tmp_path / "registrar.key").write_bytes(hospital.registrar.secret)
    cards = [
        decode_card_code(Registrar(tmp_path, hospital.genesis, hospital_clock(hospital)).issue(uid, "subject"))
        for _ in "12"
    ]
    assert cards[0].handle != cards[1].handle, "the same tag, and another number each time"
    anna = Person("anna", handle=cards[1].handle)
    hospital.must(anna.identity, "identity", "register", *hospital.register_arguments(anna, cards[1]))
    hospital.record(hospital.open_visit(anna))
    chain = b"".join(key + value for key, value in hospital.state.scan(b"", 1_000_000))
    assert cards[1].handle in chain
    assert not [digest for digest in tries if digest in chain]
    assert uid.encode() not in chain


def hospital_clock(hospital: Hospital) -> object:
    class Clock:
        def now_ms(self) -> int:
            return hospital.time_ms

    return Clock()


@pytest.mark.parametrize("offset_ms", [-7_200_123, -650, 0, 1_200, 86_400_000])
def test_defect_12_a_clock_offset_that_is_compiled_in(offset_ms: int) -> None:
    """One constant, for one pair of devices on one day. Here each device's clock is measured while it runs."""
    clocks, depth, moved = RunClocks(), np.zeros((1, 1), dtype=np.uint16), []
    for step in range(600):
        now_ms = START_MS + step * 100
        clocks.admit(Frame(now_ms, step, depth, now_ms + 5 + step % 7))
        stamp_ms = now_ms - offset_ms
        reading = Sighting(stamp_ms, stamp_ms, "E1", 1, Facing.FRONT, -50.0, 2.0, 0.2)
        admitted = clocks.admit(replace(reading, received_at_ms=now_ms + 5 + step % 11))
        moved += [(now_ms, event) for event in admitted if step > 300]
    assert len(moved) > 250
    assert all(isinstance(event, Sighting) and abs(event.first_seen_ms - now_ms) <= 20 for now_ms, event in moved)
    assert abs(clocks.estimates()["reader"].offset_ms - offset_ms) <= 20


def test_defect_13_everybody_gets_the_full_frame() -> None:
    """The other person included. Here each owner's rendition shows her alone, and with two people nobody else."""
    scenario = published_run_1()
    renderer, frames, truth = Renderer(scenario), [], {}
    for index in range(int(2.0 * scenario.frame_rate), int(9.5 * scenario.frame_rate), 3):
        depth, truth[index] = renderer.frame_with_truth(index)
        frames.append(Frame(round(index * 1000 / scenario.frame_rate), index, depth))
    seen = []
    for reading in readings(scenario):
        at = round(reading.at_s * 1000)
        sighting = Sighting(
            at, at, "", reading.antenna, reading.facing, reading.rssi_dbm, reading.distance_m, reading.sigma_m
        )
        seen.append((reading.alias, sighting))
    clip = Clip(scenario, [renderer.empty_frame(number) for number in range(12)], frames, truth, seen)
    foreign = total = beside_others = 0
    for kept in (output for output in play(clip, clip.sightings)[0] if isinstance(output, KeptFrame)):
        labels = truth[kept.sequence]
        box = labels[
            kept.cutout.y : kept.cutout.y + kept.cutout.height, kept.cutout.x : kept.cutout.x + kept.cutout.width
        ]
        shown = pixels(kept) > 0
        foreign += np.count_nonzero(shown & (box != 0) & (box != OWNERS[kept.alias]))
        total += np.count_nonzero(shown)
        beside_others += len(set(np.unique(labels)) - {0, OWNERS[kept.alias]}) > 0
    assert beside_others > 5, "two people were in the picture"
    assert foreign <= 0.001 * total
