"""Envelopes: they open with the right key in the right place, and say so in one way if not."""

from __future__ import annotations

import pytest
from nacl.public import PrivateKey

from consensus.errors import BlockRobotError
from consensus.limits import SEALED_METADATA_BYTES
from consensus.records.envelopes import (
    SEALED_KEY_BYTES,
    open_bytes,
    open_data_key,
    open_frame,
    open_metadata,
    open_sealed,
    seal_bytes,
    seal_data_key,
    seal_frame,
    seal_metadata,
    seal_to,
)

KEY, OTHER_KEY, NONCE, RECORD_ID = bytes(range(32)), bytes(32), bytes(range(24)), bytes(range(16))
PERSON, STRANGER = PrivateKey(bytes(range(32))), PrivateKey(bytes(range(1, 33)))


def code_of(action, *arguments) -> str:
    with pytest.raises(BlockRobotError) as refusal:
        action(*arguments)
    return refusal.value.code


def test_the_cipher_is_xchacha20_poly1305_as_published() -> None:
    """The vector of draft-irtf-cfrg-xchacha-03, A.3.1, which has 12 bytes of associated data; ours are 20."""
    from nacl.bindings import crypto_aead_xchacha20poly1305_ietf_encrypt

    plaintext = (
        b"Ladies and Gentlemen of the class of '99: If I could offer you only one tip for the future, "
        b"sunscreen would be it."
    )
    associated = bytes.fromhex("50515253c0c1c2c3c4c5c6c7")
    key, nonce = bytes(range(0x80, 0xA0)), bytes(range(0x40, 0x58))
    sealed = crypto_aead_xchacha20poly1305_ietf_encrypt(plaintext, associated, nonce, key)
    assert sealed[-16:].hex() == "c0875924c1c7987947deafd8780acf49"
    ours = crypto_aead_xchacha20poly1305_ietf_encrypt(plaintext, RECORD_ID + b"\x00\x00\x00\x07", nonce, key)
    assert seal_bytes(key, nonce, RECORD_ID, 7, plaintext) == nonce + ours


def test_a_frame_opens_only_with_its_key_in_its_place() -> None:
    sealed = seal_frame(KEY, NONCE, RECORD_ID, 3, b"picture")
    assert open_frame(KEY, RECORD_ID, 3, sealed) == b"picture"
    wrong = [
        (OTHER_KEY, RECORD_ID, 3, sealed),
        (KEY, bytes(16), 3, sealed),
        (KEY, RECORD_ID, 2, sealed),
        (KEY, RECORD_ID, 3, sealed[:-1]),
        (KEY, RECORD_ID, 3, bytes((sealed[0] ^ 1,)) + sealed[1:]),
        (KEY, RECORD_ID, 3, b""),
        (KEY[:31], RECORD_ID, 3, sealed),
    ]
    for arguments in wrong:
        assert code_of(open_frame, *arguments) == "ENVELOPE_INVALID"


def test_envelopes_and_sealed_metadata_have_one_size_for_like_contents() -> None:
    assert len(seal_frame(KEY, NONCE, RECORD_ID, 0, b"a")) == len(seal_frame(KEY, NONCE, RECORD_ID, 0, bytes(900)))
    public = bytes(PERSON.public_key)
    for text in (b"", b"sensor", bytes(508)):
        sealed = seal_metadata(public, text)
        assert len(sealed) == SEALED_METADATA_BYTES
        assert open_metadata(bytes(PERSON), sealed) == text
    assert code_of(seal_metadata, public, bytes(509)) == "UPLOAD_INVALID"
    assert code_of(open_metadata, bytes(PERSON), bytes(559)) == "ENVELOPE_INVALID"
    assert code_of(open_metadata, bytes(STRANGER), seal_metadata(public, b"sensor")) == "ENVELOPE_INVALID"


def test_an_envelope_without_padding_inside_is_no_frame() -> None:
    bare = seal_bytes(KEY, NONCE, RECORD_ID, 0, b"not padded")
    assert open_bytes(KEY, RECORD_ID, 0, bare) == b"not padded"
    assert code_of(open_frame, KEY, RECORD_ID, 0, bare) == "ENVELOPE_INVALID"


def test_keys_nonces_and_record_ids_of_other_sizes_are_refused() -> None:
    assert code_of(seal_bytes, KEY[:31], NONCE, RECORD_ID, 0, b"") == "KEY_INVALID"
    assert code_of(seal_bytes, KEY, NONCE[:23], RECORD_ID, 0, b"") == "KEY_INVALID"
    assert code_of(seal_bytes, KEY, NONCE, RECORD_ID[:15], 0, b"") == "VALUE_INVALID"


def test_a_data_key_is_sealed_to_one_person_and_never_twice_the_same() -> None:
    sealed = seal_data_key(bytes(PERSON.public_key), KEY)
    assert len(sealed) == SEALED_KEY_BYTES == 80
    assert open_data_key(bytes(PERSON), sealed) == KEY
    assert code_of(open_data_key, bytes(STRANGER), sealed) == "ENVELOPE_INVALID"
    assert code_of(open_data_key, bytes(PERSON), sealed[:-1]) == "ENVELOPE_INVALID"
    assert code_of(open_data_key, bytes(PERSON), sealed + b"\x00") == "ENVELOPE_INVALID"
    assert seal_data_key(bytes(PERSON.public_key), KEY) != seal_data_key(bytes(PERSON.public_key), KEY)


def test_nothing_is_sealed_to_or_opened_by_a_key_that_is_none() -> None:
    assert code_of(seal_to, bytes(31), b"text") == "KEY_INVALID"
    assert code_of(seal_to, bytes(32), b"text") == "KEY_INVALID"
    assert code_of(seal_data_key, bytes(PERSON.public_key), KEY[:31]) == "KEY_INVALID"
    assert code_of(open_sealed, bytes(PERSON), bytes(47)) == "ENVELOPE_INVALID"
    assert code_of(open_sealed, bytes(31), seal_to(bytes(PERSON.public_key), b"text")) == "ENVELOPE_INVALID"
