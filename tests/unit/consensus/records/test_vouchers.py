"""Cards: their codes survive typing and betray damage; their signatures bind what they must bind."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.members.vouchers import (
    CARD_TAG,
    ROLES,
    ROTATION_TAG,
    Card,
    card_message,
    decode_card_code,
    encode_card_code,
    issue_card,
    recover_registrar,
    rotation_message,
    sign_card,
    sign_rotation,
    voucher_message,
)
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey, recover

CHAIN = sha256(b"chain")
REGISTRAR = PrivateKey(sha256(b"registrar"))
MEMBER, SPEND, VIEW = (PrivateKey(sha256(name)).public_key for name in (b"m", b"s", b"v"))
SEALING = sha256(b"x")


def _card(role: str = "subject") -> Card:
    return issue_card(
        REGISTRAR,
        chain_id=CHAIN,
        handle=sha256(b"handle"),
        card_secret=sha256(b"card"),
        role=role,
        not_after_ms=1_800_000_000_000,
    )


@pytest.mark.parametrize("role", ROLES)
def test_a_code_holds_the_whole_card(role: str) -> None:
    card = _card(role)
    code = encode_card_code(card)
    assert code.startswith("BR1-")
    assert decode_card_code(code) == card
    assert recover_registrar(decode_card_code(code), CHAIN) == REGISTRAR.public_key


def test_a_code_may_be_typed_carelessly_and_an_old_card_is_told_from_a_damaged_one() -> None:
    code = encode_card_code(_card())
    body = code[4:].replace("-", "").lower().replace("o", "0").replace("i", "1")
    spaced = " ".join(body[start : start + 5] for start in range(0, len(body), 5))
    assert decode_card_code(f"  br1-{spaced}\n") == _card()
    card = _card()
    code = encode_card_code(card)
    assert decode_card_code(code, card.not_after_ms) == card
    with pytest.raises(BlockRobotError, match="VOUCHER_EXPIRED"):
        decode_card_code(code, card.not_after_ms + 1)


def test_a_mistyped_or_cut_off_code_is_noticed() -> None:
    code = encode_card_code(_card())
    for place in range(4, len(code)):
        if code[place] == "-":
            continue
        other = "A" if code[place] != "A" else "B"
        with pytest.raises(BlockRobotError, match="VOUCHER_INVALID"):
            decode_card_code(code[:place] + other + code[place + 1 :])
    for length in range(len(code)):
        with pytest.raises(BlockRobotError, match="VOUCHER_INVALID"):
            decode_card_code(code[:length])


@pytest.mark.parametrize("code", ["", "BR1-", "BR2-AAAA", "BR1-????", "BR1-" + "A" * 5000, "BR1-ÄÖÜ", "hello"])
def test_what_is_no_code_is_refused(code: str) -> None:
    with pytest.raises(BlockRobotError, match="VOUCHER_INVALID"):
        decode_card_code(code)


def test_the_secret_does_not_show() -> None:
    assert _card().card_secret.hex() not in repr(_card())
    assert repr(_card().card_secret) not in repr(_card())


def test_a_voucher_binds_each_of_its_fields() -> None:
    card = _card()
    altered = [
        Card(sha256(b"other"), card.card_secret, card.role, card.not_after_ms, card.voucher_signature),
        Card(card.handle, sha256(b"other"), card.role, card.not_after_ms, card.voucher_signature),
        Card(card.handle, card.card_secret, "robot", card.not_after_ms, card.voucher_signature),
        Card(card.handle, card.card_secret, card.role, card.not_after_ms + 1, card.voucher_signature),
    ]
    for changed in altered:
        assert recover_registrar(changed, CHAIN) != REGISTRAR.public_key
    assert recover_registrar(card, sha256(b"other chain")) != REGISTRAR.public_key


def test_the_cards_signature_is_by_the_cards_key_over_all_four_keys() -> None:
    card = _card()
    keys = {"member": MEMBER, "spend": SPEND, "view": VIEW, "sealing": SEALING}
    signature = sign_card(card, chain_id=CHAIN, **keys)
    message = card_message(CHAIN, card.handle, **keys)
    assert recover(CARD_TAG, signature, message) == card.card_public
    for name, key in keys.items():
        other = card_message(CHAIN, card.handle, **{**keys, name: bytes(len(key))})
        assert recover(CARD_TAG, signature, other) != card.card_public


def test_a_rotation_names_old_and_new_key() -> None:
    new = PrivateKey(sha256(b"new"))
    keys = {"member": MEMBER, "spend": SPEND, "view": VIEW, "sealing": SEALING}
    signature = sign_rotation(new, chain_id=CHAIN, handle=sha256(b"handle"), **keys)
    message = rotation_message(CHAIN, sha256(b"handle"), new_member=new.public_key, **keys)
    assert recover(ROTATION_TAG, signature, message) == new.public_key
    assert len(message) == 32 + 32 + 4 * 33 + 32


def test_messages_refuse_fields_of_wrong_size() -> None:
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        voucher_message(CHAIN, bytes(31), MEMBER, "subject", 1)
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        voucher_message(CHAIN, bytes(32), MEMBER, "king", 1)
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        card_message(CHAIN, bytes(32), MEMBER, SPEND, VIEW, bytes(33))
