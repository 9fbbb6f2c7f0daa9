"""Three custodians, one of which lies about what was shared: it spoils only what it gave itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from clients.wallet.ledger.wallet import Wallet
from clients.wallet.sharing.incoming_shares import IncomingShare, IncomingShares
from consensus.errors import BlockRobotError
from consensus.records.sharing import KeyPart, SharedDownload, seal_package
from tests.unit.contracts.privacy.hospital import key_of
from tests.world.sharing import SharedWard, ThreeCustodians

NAMES = ThreeCustodians.custodian_names
FIRST, SECOND, THIRD = (key_of(name).public_key for name in NAMES)
FORGED = b"f" * 32
Lie = Callable[[SharedDownload, IncomingShare, Wallet], SharedDownload]


def _changed(answer: SharedDownload, **changes: object) -> SharedDownload:
    return msgspec.structs.replace(answer, **changes)


def as_another(answer: SharedDownload, _: IncomingShare, __: Wallet) -> SharedDownload:
    """Parts of noise under the key of the custodian that was asked before it."""
    return _changed(answer, custodian=FIRST, parts=[KeyPart(SECOND, FORGED), KeyPart(THIRD, FORGED)])


def short_parts(answer: SharedDownload, _: IncomingShare, __: Wallet) -> SharedDownload:
    return _changed(answer, parts=[KeyPart(part.custodian, part.value[:31]) for part in answer.parts])


def no_parts(answer: SharedDownload, _: IncomingShare, __: Wallet) -> SharedDownload:
    return _changed(answer, parts=[])


def parts_twice(answer: SharedDownload, _: IncomingShare, __: Wallet) -> SharedDownload:
    return _changed(answer, parts=[*answer.parts, *answer.parts])


def for_nobody(answer: SharedDownload, _: IncomingShare, __: Wallet) -> SharedDownload:
    return _changed(answer, parts=[KeyPart(b"", part.value) for part in answer.parts])


def noise(answer: SharedDownload, _: IncomingShare, __: Wallet) -> SharedDownload:
    return _changed(answer, package=b"x" * 200, parts=[KeyPart(part.custodian, FORGED) for part in answer.parts])


def a_package_of_its_own(answer: SharedDownload, receipt: IncomingShare, doctor: Wallet) -> SharedDownload:
    """Well made, for the right grantee, with a key that it claims to hold alone; what is in it opens nothing."""
    package = seal_package(
        FORGED,
        bytes(24),
        doctor.keys.sealing_public,
        grantee=receipt.grant.row.grantee,
        record_id=answer.record_id,
        keys={0: FORGED, 1: FORGED},
    )
    return _changed(answer, package=package, parts=[KeyPart(answer.custodian, FORGED)])


def of_another_record(answer: SharedDownload, _: IncomingShare, __: Wallet) -> SharedDownload:
    return _changed(answer, frames=answer.frames[:1], commitment_leaves=[], ciphertext_leaves=[b"short"])


def without_the_clip(answer: SharedDownload, _: IncomingShare, __: Wallet) -> SharedDownload:
    """No lie of one that is not to keep it; its parts count all the same."""
    return _changed(answer, frames=[], commitment_leaves=[], ciphertext_leaves=[])


LIES = (
    as_another,
    short_parts,
    no_parts,
    parts_twice,
    for_nobody,
    noise,
    a_package_of_its_own,
    of_another_record,
    without_the_clip,
)


@pytest.mark.parametrize("liar", NAMES)
@pytest.mark.parametrize("lie", LIES)
async def test_one_liar_of_three_keeps_nothing_back(tmp_path: Path, lie: Lie, liar: str) -> None:
    """Wherever the liar stands in the order in which they are asked."""
    ward = SharedWard(tmp_path, ThreeCustodians)
    doctor = ward.come_in("doctor", "staff")
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    receiving = ward.receiving(doctor)
    (receipt,) = await receiving.inbox()
    ward.custody.lie = lambda name, answer: lie(answer, receipt, doctor) if name == liar else answer
    access_id = await receiving.request_access(receipt, ids)
    view = await receiving.look(receipt, ids[0], access_id)
    assert [frame.status for frame in view.frames] == ["ok", "ok"]
    assert len(view.custodians) >= 2


async def test_two_liars_of_three_are_told_of_by_a_code_or_a_status(tmp_path: Path) -> None:
    ward = SharedWard(tmp_path, ThreeCustodians)
    doctor = ward.come_in("doctor", "staff")
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    receiving = ward.receiving(doctor)
    (receipt,) = await receiving.inbox()
    for lie in LIES:
        access_id = await receiving.request_access(receipt, ids)
        ward.custody.lie = lambda name, answer, lie=lie: (  # type: ignore[misc]
            answer if name == "custodian-3" else lie(answer, receipt, doctor)
        )
        found = await _look(receiving, receipt, ids[0], access_id)
        assert found <= {"GRANT_PARTS_MISSING", "ENVELOPE_INVALID"} or found <= {"ok", "corrupted"}, lie


async def test_where_nobody_has_the_clip_its_parts_show_nothing_and_that_is_told(tmp_path: Path) -> None:
    ward = SharedWard(tmp_path, ThreeCustodians)
    doctor = ward.come_in("doctor", "staff")
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    receiving = ward.receiving(doctor)
    (receipt,) = await receiving.inbox()
    ward.custody.lie = lambda _, answer: without_the_clip(answer, receipt, doctor)
    access_id = await receiving.request_access(receipt, ids)
    assert await _look(receiving, receipt, ids[0], access_id) == {"CLIP_NOT_CONFIRMED"}


async def _look(receiving: IncomingShares, receipt: IncomingShare, record_id: bytes, access_id: bytes) -> set[str]:
    """What frames were found to be, or the code of the refusal."""
    try:
        view = await receiving.look(receipt, record_id, access_id)
    except BlockRobotError as error:
        return {error.code}
    return {frame.status for frame in view.frames}
