"""Guardians' shares: any that are enough lead back to the same 24 words, fewer to nothing, and sets do not mix."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mnemonic import Mnemonic
from shamir_mnemonic import EncryptedMasterSecret, Share, split_ems
from shamir_mnemonic.wordlist import WORDLIST

from clients.wallet.recovery.slip39_shares import (
    ShareCollector,
    find_unknown,
    near_words,
    read_share,
    split_mnemonic,
    tokenize_words,
)
from consensus.errors import BlockRobotError

entropies = st.binary(min_size=32, max_size=32)
ways = st.integers(2, 16).flatmap(lambda count: st.tuples(st.integers(2, count), st.just(count)))


def words_of(entropy: bytes) -> str:
    return str(Mnemonic("english").to_mnemonic(entropy))


def gathered(shares: list[str]) -> ShareCollector:
    gathering = ShareCollector()
    for share in shares:
        gathering.add(read_share(share))
    return gathering


@given(entropies, ways, st.data())
def test_any_that_are_enough_lead_back_and_one_less_never(entropy, way, data):
    threshold, count = way
    words = words_of(entropy)
    shares = split_mnemonic(words, threshold, count)
    assert {len(share.split()) for share in shares} == {33}
    chosen = data.draw(st.permutations(shares))[:threshold]
    assert gathered(chosen).join() == words
    short = gathered(chosen[:-1])
    assert (short.is_complete, short.needed) == (False, 1)
    with pytest.raises(BlockRobotError, match="SHARES_TOO_FEW"):
        short.join()


@settings(max_examples=3)
@given(entropies)
def test_every_choice_of_three_out_of_five_leads_back(entropy):
    words = words_of(entropy)
    shares = split_mnemonic(words, 3, 5)
    for chosen in combinations(shares, 3):
        assert gathered(list(chosen)).join() == words


@given(entropies, entropies)
def test_two_sets_do_not_mix_whatever_they_are_of(first, second):
    ours, others = split_mnemonic(words_of(first), 2, 3), split_mnemonic(words_of(second), 2, 3)
    code = (
        "SHARES_CONTRADICT" if read_share(ours[0]).identifier == read_share(others[1]).identifier else "ANOTHER_SPLIT"
    )
    with pytest.raises(BlockRobotError, match=code):
        gathered([ours[0], others[1]]).join()


@given(entropies, entropies, st.integers(0, 2**15 - 1))
def test_sets_that_bear_the_same_number_by_chance_are_told_apart_by_the_digest(first, second, identifier):
    if first == second:
        return
    split = [
        split_ems(1, [(2, 3)], EncryptedMasterSecret.from_master_secret(secret, b"", identifier, True, 1))[0]
        for secret in (first, second)
    ]
    with pytest.raises(BlockRobotError, match="SHARES_CONTRADICT"):
        gathered([split[0][0].mnemonic(), split[1][1].mnemonic()]).join()


@settings(max_examples=20)
@given(entropies, st.integers(2, 4), st.data())
def test_with_one_guardian_more_than_needed_one_who_lies_keeps_nobody_out(entropy, threshold, data):
    words = words_of(entropy)
    shares = [read_share(share) for share in split_mnemonic(words, threshold, threshold + 1)]
    place = data.draw(st.integers(0, threshold))
    shares[place] = replace(shares[place], value=data.draw(st.binary(min_size=32, max_size=32)))
    assert gathered([share.mnemonic() for share in shares]).join() == words


heads = st.fixed_dictionaries(
    {"value": st.binary(min_size=32, max_size=32)},
    optional={
        "identifier": st.integers(0, 2**15 - 1),
        "iteration_exponent": st.integers(0, 2),
        "extendable": st.booleans(),
        "index": st.integers(0, 15),
        "member_threshold": st.integers(2, 16),
        "group_index": st.integers(0, 15),
        "group_count": st.integers(1, 16),
    },
)


@given(entropies, st.integers(2, 4), heads, st.data())
def test_whatever_a_guardian_who_lies_says_of_the_set_or_of_her_number_the_others_come_through(
    entropy, threshold, said, data
):
    words = words_of(entropy)
    shares = [read_share(share) for share in split_mnemonic(words, threshold, threshold + 1)]
    place = data.draw(st.integers(0, threshold))
    lie = replace(shares[place], **said)
    shares[place] = lie
    joined = gathered([share.mnemonic() for share in data.draw(st.permutations(shares))])
    assert joined.join() == words
    assert joined.misfits() == [lie]
    assert lie not in joined.joined


@settings(max_examples=10)
@given(entropies)
def test_of_the_shares_that_are_left_over_only_those_that_do_not_fit_are_named(entropy):
    shares = [read_share(share) for share in split_mnemonic(words_of(entropy), 2, 5)]
    shares[1] = replace(shares[1], value=bytes(32))
    joined = gathered([share.mnemonic() for share in shares])
    assert joined.misfits() == []
    joined.join()
    assert joined.misfits() == [shares[1]]


def test_each_choice_of_shares_is_tried_once_and_no_more_than_some_thousand():
    shares = [read_share(share) for share in split_mnemonic(words_of(bytes(32)), 3, 16)]
    joined = gathered([replace(share, value=bytes([share.index] * 32)).mnemonic() for share in shares])
    for _ in range(3):
        with pytest.raises(BlockRobotError, match="SHARES_CONTRADICT"):
            joined.join()
    for share in shares[:2]:
        joined.add(share)
        with pytest.raises(BlockRobotError, match="SHARES_CONTRADICT"):
            joined.join()
    joined.add(shares[2])
    assert joined.join() == words_of(bytes(32))


@given(entropies, st.integers(0, 32), st.sampled_from(WORDLIST))
def test_one_wrong_word_is_always_noticed(entropy, place, word):
    share = split_mnemonic(words_of(entropy), 2, 2)[0].split()
    if share[place] == word:
        return
    share[place] = word
    with pytest.raises(BlockRobotError, match="SHARE_INVALID"):
        read_share(" ".join(share))


@given(entropies, st.integers(0, 31))
def test_two_words_that_changed_places_are_always_noticed(entropy, place):
    share = split_mnemonic(words_of(entropy), 2, 2)[0].split()
    share[place], share[place + 1] = share[place + 1], share[place]
    if share[place] != share[place + 1]:
        with pytest.raises(BlockRobotError, match="SHARE_INVALID"):
            read_share(" ".join(share))


@given(st.text(max_size=300))
def test_whatever_is_written_is_read_or_refused(written):
    with pytest.raises(BlockRobotError, match=r"SHARE_(WORD_UNKNOWN|INVALID)"):
        read_share(written)


@given(st.sampled_from(WORDLIST), st.data())
def test_a_word_with_one_letter_amiss_finds_its_way(word, data):
    place = data.draw(st.integers(0, len(word) - 1))
    letter = data.draw(st.sampled_from("abcdefghijklmnopqrstuvwxyz"))
    written = word[:place] + letter + word[place + 1 :]
    assert find_unknown([written]) == (None if written in WORDLIST else 0)
    assert len(near_words(written)) <= 3
    if place >= 4:
        assert word in near_words(written)


def test_numbers_and_signs_between_words_do_not_matter():
    shares = split_mnemonic(words_of(bytes(32)), 2, 3)
    numbered = "\n".join(f" {number:>2}. {word.upper()}," for number, word in enumerate(shares[0].split(), 1))
    assert tokenize_words(numbered) == shares[0].split()
    assert isinstance(read_share(numbered), Share)
    assert read_share(numbered) == read_share(shares[0])
