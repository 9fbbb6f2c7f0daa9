"""SLIP-39 shares of the 24 words' entropy, by the reference implementation.

No passphrase: a wrong one would silently give another mnemonic.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Sequence
from itertools import chain, combinations, islice, product

from mnemonic import Mnemonic
from shamir_mnemonic import MnemonicError, Share, generate_mnemonics
from shamir_mnemonic.recovery import RecoveryState
from shamir_mnemonic.wordlist import WORD_INDEX_MAP, WORDLIST

from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError

SHARE_WORDS_COUNT = 33
GUARDIANS_MIN_COUNT = 2
GUARDIANS_MAX_COUNT = 16
THRESHOLD_MIN_COUNT = 2
"""A share of one would be the wallet itself."""
IDENTIFIER_DIGITS_COUNT = 5
NEAR_WORDS_MAX_COUNT = 3
ITERATION_EXPONENT = 1
"""The reference implementation's own: 20,000 rounds. They harden a passphrase, and there is none."""
ITERATION_EXPONENT_MAX_COUNT = 5
"""No set of ours asks for more work; forged shares must not make the machine work for minutes."""
CHOICES_MAX_COUNT = 20_000
"""Eight of sixteen are 12,870; with more, shares were put in to keep the machine busy."""
_ENTROPY_BYTES = 32
_NO_PASSPHRASE = b""
_DISTINCT_LETTERS_COUNT = 4
"""The list's words differ within so many."""
_BETWEEN_WORDS = re.compile(r"[\s\d.,;:()\[\]]+")


def split_mnemonic(words: str, threshold: int, count: int) -> list[str]:
    """Return `count` shares (33 words each) of a 24-word mnemonic; any `threshold` restore it.

    Shares are test-joined first. Raises ValueError unless 2 <= threshold <= count <= 16, AssertionError if joining
    fails.
    """
    if not THRESHOLD_MIN_COUNT <= threshold <= count <= GUARDIANS_MAX_COUNT:
        raise ValueError(f"{threshold} of {count} is no way to split")
    entropy = bytes(Mnemonic("english").to_entropy(words.split()))
    ((*shares,),) = generate_mnemonics(
        1, [(threshold, count)], entropy, _NO_PASSPHRASE, extendable=True, iteration_exponent=ITERATION_EXPONENT
    )
    for start in range(0, count, threshold):
        joined = ShareCollector()
        for place in range(threshold):
            joined.add(read_share(shares[(start + place) % count]))
        if joined.join() != words:
            raise AssertionError("the shares do not lead back to the words")
    return list(shares)


def show_identifier(identifier: int) -> str:
    return f"{identifier:0{IDENTIFIER_DIGITS_COUNT}d}"


def tokenize_words(written: str) -> list[str]:
    return [word for word in _BETWEEN_WORDS.split(written.lower()) if word]


def find_unknown(words: Sequence[str]) -> int | None:
    """None if all are in the list."""
    return next((place for place, word in enumerate(words) if word not in WORD_INDEX_MAP), None)


def near_words(word: str) -> list[str]:
    """Up to three of the list, likeliest first."""
    begun = [known for known in WORDLIST if known[:_DISTINCT_LETTERS_COUNT] == word[:_DISTINCT_LETTERS_COUNT]]
    alike = difflib.get_close_matches(word, WORDLIST, NEAR_WORDS_MAX_COUNT)
    return list(dict.fromkeys([*begun, *alike]))[:NEAR_WORDS_MAX_COUNT]


def read_share(written: str) -> Share:
    """Raises SHARE_WORD_UNKNOWN (gives position, not word), SHARE_INVALID."""
    words = tokenize_words(written)
    unknown = find_unknown(words)
    if unknown is not None:
        raise refusal("SHARE_WORD_UNKNOWN", "guardian_word", number=unknown + 1)
    try:
        return Share.from_mnemonic(" ".join(words))
    except MnemonicError:
        if len(words) == SHARE_WORDS_COUNT:
            raise BlockRobotError("SHARE_INVALID") from None
        raise refusal("SHARE_INVALID", "guardian_words", count=len(words), wanted=SHARE_WORDS_COUNT) from None


def require_of_wallet(share: Share) -> None:
    """Raise SHARE_INVALID for foreign shares: other length, excessive work, or threshold one."""
    if len(share.value) != _ENTROPY_BYTES or share.iteration_exponent > ITERATION_EXPONENT_MAX_COUNT:
        raise refusal("SHARE_INVALID", "guardian_other")
    if share.group_threshold < THRESHOLD_MIN_COUNT and share.member_threshold < THRESHOLD_MIN_COUNT:
        raise refusal("SHARE_INVALID", "guardian_alone")


class ShareCollector:
    """Shares collected until some restore one secret; contradicting ones are kept, as only the digest decides.

    `joined` are those that led to the mnemonic, empty before.
    """

    def __init__(self) -> None:
        self.joined: list[Share] = []
        self._shares: list[Share] = []
        self._tried_count = 0
        self._choices_count = 0
        self._difference: BlockRobotError | None = None

    def add(self, share: Share) -> BlockRobotError | None:
        """Keep a share; return how it differs from earlier ones, or None. Raises SHARE_REPEATED."""
        if share in self._shares:
            raise BlockRobotError("SHARE_REPEATED")
        difference = self._compare(share)
        self._shares.append(share)
        self._difference = difference or self._difference
        return difference

    def _compare(self, share: Share) -> BlockRobotError | None:
        if not self._shares:
            return None
        alike = [known for known in self._shares if _is_like(known, share)]
        if any((known.group_index, known.index) == (share.group_index, share.index) for known in alike):
            return refusal("SHARES_CONTRADICT", "guardian_differ")
        if alike:
            return None
        first = self._shares[0]
        key = "guardian_set_differs" if first.identifier == share.identifier else "guardian_set"
        return refusal("SHARE_OF_ANOTHER_SPLIT", key, set=show_identifier(first.identifier))

    @property
    def last(self) -> Share | None:
        return self._shares[-1] if self._shares else None

    @property
    def is_complete(self) -> bool:
        return any(
            len(self._complete_groups(known)) >= known.group_threshold
            for known in {share.common_parameters(): share for share in self._shares}.values()
        )

    def _members(self, share: Share) -> list[Share]:
        return [known for known in self._shares if known.group_parameters() == share.group_parameters()]

    def _complete_groups(self, share: Share) -> dict[int, list[Share]]:
        found: dict[int, list[Share]] = {}
        for known in {one.group_parameters(): one for one in self._shares}.values():
            is_of_set = known.common_parameters() == share.common_parameters()
            if is_of_set and len({one.index for one in self._members(known)}) >= known.member_threshold:
                found.setdefault(known.group_index, []).append(known)
        return found

    @property
    def needed(self) -> int:
        """By the last share's group; 0 before the first."""
        if self.last is None:
            return 0
        return max(0, int(self.last.member_threshold) - len({one.index for one in self._members(self.last)}))

    @property
    def groups_needed(self) -> int:
        return (
            0 if self.last is None else max(0, int(self.last.group_threshold) - len(self._complete_groups(self.last)))
        )

    def join(self) -> str:
        """Return the mnemonic to which any choice of shares leads; misfits are left out.

        Raises SHARES_TOO_FEW, how they differ, or SHARES_CONTRADICT (no digest fits, or too many choices).
        """
        return str(Mnemonic("english").to_mnemonic(self.join_secret(_NO_PASSPHRASE)))

    def join_secret(self, passphrase: bytes) -> bytes:
        if not self.is_complete:
            raise self._difference or BlockRobotError("SHARES_TOO_FEW")
        tried_count, self._tried_count = self._tried_count, len(self._shares)
        tried = set(self._shares[:tried_count])
        for chosen in self._choices():
            if tried.issuperset(chosen) or (len(chosen) == 1 and self._difference):
                continue
            self._choices_count += 1
            if self._choices_count > CHOICES_MAX_COUNT:
                raise refusal("SHARES_CONTRADICT", "guardian_many")
            secret = _recover(chosen, passphrase)
            if secret is not None:
                self.joined = list(chosen)
                self._tried_count = tried_count
                return secret
        untried = None if self._choices_count else self._difference
        raise untried or BlockRobotError("SHARES_CONTRADICT")

    def _choices(self) -> Iterator[tuple[Share, ...]]:
        for known in {share.common_parameters(): share for share in self._shares}.values():
            complete = self._complete_groups(known)
            for indices in combinations(sorted(complete), known.group_threshold):
                for groups in product(*(complete[index] for index in indices)):
                    ways = (_member_choices(self._members(group), group.member_threshold) for group in groups)
                    for chosen in product(*(islice(way, CHOICES_MAX_COUNT + 1) for way in ways)):
                        yield tuple(chain.from_iterable(chosen))

    def misfits(self) -> list[Share]:
        secret = _recover(self.joined, _NO_PASSPHRASE) if self.joined else None
        return [share for share in self._shares if secret is not None and not self._fits(share, secret)]

    def _fits(self, share: Share, secret: bytes) -> bool:
        if share in self.joined:
            return True
        beside = [known for known in self.joined if known.group_parameters() == share.group_parameters()]
        same_number = [known for known in beside if known.index == share.index]
        if not beside or same_number:
            return False
        others = [known for known in self.joined if known is not beside[0]]
        return _recover([*others, share], _NO_PASSPHRASE) == secret


def _is_like(known: Share, share: Share) -> bool:
    is_same_group = known.group_index == share.group_index
    return known.common_parameters() == share.common_parameters() and (
        not is_same_group or known.member_threshold == share.member_threshold
    )


def _member_choices(members: Sequence[Share], count: int) -> Iterator[tuple[Share, ...]]:
    for chosen in combinations(members, count):
        if len({share.index for share in chosen}) == count:
            yield chosen


def _recover(chosen: Sequence[Share], passphrase: bytes) -> bytes | None:
    state = RecoveryState()
    for share in chosen:
        state.add_share(share)
    try:
        return bytes(state.recover(passphrase))
    except MnemonicError:
        return None
