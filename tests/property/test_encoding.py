"""Properties of the canonical encoding, over whatever hypothesis thinks of."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from consensus.chain.block import Header, IndexedSignature, QuorumCertificate, TimeoutCertificate, TimeoutSignature
from consensus.chain.messages import CertificateNotice, Timeout, Vote
from consensus.chain.transaction import TransactionBody, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, decode_value, encode, encode_value

integers = st.integers(-(2**256) + 1, 2**256 - 1)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
keys = st.one_of(texts, st.binary(max_size=20), st.integers(-(2**60) + 1, 2**60 - 1))
values = st.recursive(
    st.one_of(st.none(), st.booleans(), integers, texts, st.binary(max_size=40)),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(keys, inner, max_size=4)),
    max_leaves=12,
)
small = st.integers(0, 2**63 - 1)
signatures = st.binary(min_size=64, max_size=64)
ids = st.binary(min_size=32, max_size=32)
qcs = st.builds(
    QuorumCertificate,
    epoch=small,
    round=small,
    block_id=ids,
    votes=st.lists(st.builds(IndexedSignature, index=small, signature=signatures), max_size=3).map(tuple),
)
tcs = st.builds(
    TimeoutCertificate,
    epoch=small,
    round=small,
    timeouts=st.lists(st.builds(TimeoutSignature, index=small, qc_round=small, signature=signatures), max_size=3).map(
        tuple
    ),
)
messages = st.one_of(
    qcs,
    tcs,
    st.builds(Vote, epoch=small, round=small, block_id=ids, index=small, signature=signatures),
    st.builds(Timeout, epoch=small, round=small, index=small, signature=signatures, qc=qcs, entered_by=st.none() | tcs),
    st.builds(CertificateNotice, qc=qcs, entered_by=st.none() | tcs),
)


def is_same(first, second):
    """Equality that tells True from 1, as contracts do."""
    if type(first) is not type(second):
        return False
    if isinstance(first, list):
        return len(first) == len(second) and all(map(is_same, first, second))
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(is_same(first[key], second[key]) for key in first)
    return first == second


@given(values)
def test_every_value_comes_back(value):
    assert is_same(decode_value(encode_value(value)), value)


@given(values, values)
def test_two_values_never_share_their_bytes(first, second):
    assert (encode_value(first) == encode_value(second)) == is_same(first, second)


@given(st.binary(max_size=60))
def test_whatever_decodes_encodes_to_the_same_bytes(data):
    try:
        value = decode_value(data)
    except BlockRobotError:
        return
    assert encode_value(value) == data


@given(messages)
def test_every_message_comes_back(message):
    assert decode(encode(message), type(message)) == message


@given(messages, st.data())
def test_a_changed_byte_is_another_message_or_none(message: Wire, data):
    raw = bytearray(encode(message))
    place = data.draw(st.integers(0, len(raw) - 1))
    raw[place] ^= data.draw(st.integers(1, 255))
    try:
        other = decode(bytes(raw), type(message))
    except BlockRobotError:
        return
    assert other != message
    assert encode(other) == bytes(raw)


@given(st.binary(max_size=200), st.sampled_from([Vote, Timeout, CertificateNotice, QuorumCertificate, Header]))
def test_random_bytes_never_raise_anything_else(data, kind):
    try:
        message = decode(data, kind)
    except BlockRobotError:
        return
    assert encode(message) == data


@given(st.binary(max_size=200))
def test_random_bytes_are_refused_as_transactions_politely(data):
    try:
        transaction = decode_transaction(data)
    except BlockRobotError:
        return
    assert isinstance(transaction.body, TransactionBody)
