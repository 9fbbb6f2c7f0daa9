"""The canonical encoding: one value, one byte string."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.block import IndexedSignature, QuorumCertificate
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, decode_value, encode, encode_value, u32, u64

QC = QuorumCertificate(epoch=0, round=3, block_id=bytes(32), votes=(IndexedSignature(index=1, signature=b"\x01" * 64),))


def refused(code, call, *arguments):
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        call(*arguments)


def test_a_struct_comes_back_as_it_was_from_an_array_in_field_order():
    assert decode(encode(QC), QuorumCertificate) == QC
    assert msgspec.msgpack.decode(encode(QC)) == [0, 3, bytes(32), [[1, b"\x01" * 64]]]


@pytest.mark.parametrize(
    "data",
    [b"", b"\x94", b"\x93\x00\x03\xc4\x00", b"\x81\x01\x02", b"\xc1", encode(QC)[:-1], encode(QC) + b"\x00"],
    ids=repr,
)
def test_bytes_that_are_no_such_struct_are_refused(data):
    refused("ENCODING_INVALID", decode, data, QuorumCertificate)


def test_a_struct_with_an_extra_field_or_in_a_longer_form_is_refused():
    raw = msgspec.msgpack.encode([0, 3, bytes(32), [], "more"])
    refused("ENCODING_INVALID", decode, raw, QuorumCertificate)
    longer = b"\x94\xcc\x00" + encode(QC)[2:]
    refused("ENCODING_NOT_CANONICAL", decode, longer, QuorumCertificate)


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        False,
        0,
        -1,
        127,
        128,
        2**63 - 1,
        -(2**63),
        2**64 - 1,
        2**64,
        -(2**63) - 1,
        2**255,
        2**256 - 1,
        -(2**256) + 1,
        "",
        "grüße",
        b"",
        b"\xff" * 300,
        [],
        [1, [2, [3]]],
        {},
        {"b": 1, "a": [None]},
        {b"k": 1, "k": 2, 3: 4},
    ],
    ids=lambda value: repr(value)[:30],
)
def test_values_come_back_as_they_were(value):
    again = decode_value(encode_value(value))
    assert again == value
    assert type(again) is type(value)


def test_neither_tuples_nor_the_order_in_which_a_dict_was_filled_show():
    assert encode_value((1, 2)) == encode_value([1, 2])
    assert encode_value({"a": 1, "b": 2, b"a": 3, 7: 4}) == encode_value({7: 4, b"a": 3, "b": 2, "a": 1})


def test_a_second_form_of_a_dict_or_integer_is_refused():
    refused("ENCODING_NOT_CANONICAL", decode_value, b"\x82\xa1b\x01\xa1a\x02")
    refused("ENCODING_NOT_CANONICAL", decode_value, b"\x82\xa1a\x01\xa1a\x02")
    refused("ENCODING_NOT_CANONICAL", decode_value, b"\xcd\x00\x01")
    refused("ENCODING_NOT_CANONICAL", decode_value, b"\xc7\x00\x01")


@pytest.mark.parametrize("body", [b"\x00\x01", b"\x7f" * 4, b"\xff" * 10, b"\x00\x00" + b"\xff" * 9], ids=bytes.hex)
def test_an_integer_extension_that_is_not_minimal_is_refused(body):
    refused("ENCODING_NOT_CANONICAL", decode_value, b"\xc7" + bytes([len(body)]) + b"\x01" + body)


def test_an_integer_extension_is_twos_complement_big_endian():
    assert encode_value(2**72 - 1) == b"\xc7\x0a\x01\x00" + b"\xff" * 9
    assert encode_value(-(2**71)) == b"\xc7\x09\x01\x80" + bytes(8)


@pytest.mark.parametrize("data", [b"\xcb" + bytes(8), b"\xca" + bytes(4), b"\xd6\xff" + bytes(4), b"\xd4\x05\x00"])
def test_floats_timestamps_and_unknown_extensions_are_refused(data):
    refused("ENCODING_INVALID", decode_value, data)


@pytest.mark.parametrize("value", [1.5, {1, 2}, object, bytearray(b"x"), {None: 1}, {True: 1}, {(1,): 1}], ids=repr)
def test_what_is_no_contract_value_is_refused(value):
    refused("VALUE_INVALID", encode_value, value)


def test_integers_above_256_bits_keys_above_60_and_lone_surrogates_are_refused():
    refused("VALUE_INVALID", encode_value, 2**256)
    refused("VALUE_INVALID", encode_value, -(2**256))
    assert decode_value(encode_value({2**60 - 1: 1})) == {2**60 - 1: 1}
    refused("VALUE_INVALID", encode_value, {2**60: 1})
    refused("VALUE_INVALID", encode_value, "\ud800")
    refused("VALUE_INVALID", encode_value, {"\ud800": 1})


def nested(depth):
    value = 0
    for _ in range(depth):
        value = [value]
    return value


def test_nesting_is_bounded_both_ways():
    assert decode_value(encode_value(nested(16))) == nested(16)
    refused("VALUE_INVALID", encode_value, nested(17))
    refused("ENCODING_INVALID", decode_value, b"\x91" * 17 + b"\x00")
    refused("ENCODING_INVALID", decode_value, b"\x91" * 100_000 + b"\x00")


def test_fixed_width_integers_sort_as_numbers_do():
    numbers = [0, 1, 255, 256, 2**31, 2**32 - 1]
    assert sorted(map(u32, numbers)) == list(map(u32, numbers))
    assert sorted(map(u64, numbers)) == list(map(u64, numbers))
