"""A wallet's words as shares for guardians, and back again: SLIP-39, by its reference implementation.

What is split is the entropy of the 24 words, so that the same words come back. There is no passphrase on top: a wrong one
would lead to other words without a sign. Must never keep, log or name in an error any word of a share.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from itertools import combinations

from mnemonic import Mnemonic
from shamir_mnemonic import MnemonicError, Share, generate_mnemonics
from shamir_mnemonic.recovery import RecoveryState
from shamir_mnemonic.wordlist import WORD_INDEX_MAP, WORDLIST

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
_ENTROPY_BYTES = 32
_NO_PASSPHRASE = b""
_DISTINCT_LETTERS_COUNT = 4
"""The list's words differ within so many."""
_BETWEEN_WORDS = re.compile(r"[\s\d.,;:()\[\]]+")


def split_words(words: str, threshold: int, count: int) -> list[str]:
    """Return `count` shares of 24 words, 33 words each: any `threshold` of them lead back, fewer to nothing.

    Each is read back, and as many as are needed are joined, before any is handed out. Raises AssertionError if that
    does not lead to the same words, ValueError unless 2 <= threshold <= count <= 16.
    """
    if not THRESHOLD_MIN_COUNT <= threshold <= count <= GUARDIANS_MAX_COUNT:
        raise ValueError(f"{threshold} of {count} is no way to split")
    entropy = bytes(Mnemonic("english").to_entropy(words.split()))
    ((*shares,),) = generate_mnemonics(
        1, [(threshold, count)], entropy, _NO_PASSPHRASE, extendable=True, iteration_exponent=ITERATION_EXPONENT
    )
    for start in range(0, count, threshold):
        joined = Gathering()
        for place in range(threshold):
            joined.add(read_share(shares[(start + place) % count]))
        if joined.join() != words:
            raise AssertionError("the shares do not lead back to the words")
    return list(shares)


def show_identifier(identifier: int) -> str:
    """Return a set's number as it is shown and printed, five digits."""
    return f"{identifier:0{IDENTIFIER_DIGITS_COUNT}d}"


def take_words(written: str) -> list[str]:
    """Return the words of what somebody wrote, without numbers and signs between them, in small letters."""
    return [word for word in _BETWEEN_WORDS.split(written.lower()) if word]


def find_unknown(words: Sequence[str]) -> int | None:
    """Return the place of the first word that no share has, counted from 0, or None."""
    return next((place for place, word in enumerate(words) if word not in WORD_INDEX_MAP), None)


def near_words(word: str) -> list[str]:
    """Return the words of the list that somebody may have meant, the likeliest first, three at most."""
    begun = [known for known in WORDLIST if known[:_DISTINCT_LETTERS_COUNT] == word[:_DISTINCT_LETTERS_COUNT]]
    alike = difflib.get_close_matches(word, WORDLIST, NEAR_WORDS_MAX_COUNT)
    return list(dict.fromkeys([*begun, *alike]))[:NEAR_WORDS_MAX_COUNT]


def read_share(written: str) -> Share:
    """Return the share that these words are, numbers between them or not.

    Raises SHARE_WORD_UNKNOWN, which names the number of the word and not the word, and SHARE_INVALID.
    """
    words = take_words(written)
    unknown = find_unknown(words)
    if unknown is not None:
        raise BlockRobotError("SHARE_WORD_UNKNOWN", f"Word {unknown + 1} is not on the list.", number=unknown + 1)
    try:
        return Share.from_mnemonic(" ".join(words))
    except MnemonicError:
        detail = "" if len(words) == SHARE_WORDS_COUNT else f"These are {len(words)} words, not {SHARE_WORDS_COUNT}."
        raise BlockRobotError("SHARE_INVALID", detail) from None


def require_of_wallet(share: Share) -> None:
    """Raise SHARE_INVALID for a share of something that is no wallet of ours: another length, or far too much work.

    Also for one that is enough by itself: nobody was ever handed one, and its words would be the guardian's own.
    """
    if len(share.value) != _ENTROPY_BYTES or share.iteration_exponent > ITERATION_EXPONENT_MAX_COUNT:
        raise BlockRobotError("SHARE_INVALID", "These words are whole, but a share of something else than a wallet.")
    if share.group_threshold < THRESHOLD_MIN_COUNT and share.member_threshold < THRESHOLD_MIN_COUNT:
        raise BlockRobotError(
            "SHARE_INVALID", "These words lead to a wallet alone, which no guardian's do: it would not be yours."
        )


class Gathering:
    """Shares that come in one by one, until they are enough. `state` is the reference implementation's own."""

    def __init__(self) -> None:
        self.state = RecoveryState()
        self._shares: list[Share] = []

    def add(self, share: Share) -> None:
        """Take in a share. Raises SHARE_OF_ANOTHER_SPLIT, SHARE_REPEATED, and SHARES_CONTRADICT if one is forged."""
        if share in self.state:
            raise BlockRobotError("SHARE_REPEATED")
        if not self.state.matches(share):
            raise self._of_another()
        if any(known.index == share.index for known in self.state.groups[share.group_index]):
            raise BlockRobotError("SHARES_CONTRADICT", "Two of these shares have the same number, and differ.")
        try:
            self.state.add_share(share)
        except MnemonicError:
            raise self._of_another() from None
        self._shares.append(share)

    def _of_another(self) -> BlockRobotError:
        known = self.state.parameters
        detail = "" if known is None else f"It is not of set {show_identifier(known.identifier)}."
        return BlockRobotError("SHARE_OF_ANOTHER_SPLIT", detail)

    @property
    def is_complete(self) -> bool:
        """Tell whether these are enough."""
        return bool(self.state.is_complete())

    @property
    def needed(self) -> int:
        """How many more are needed in the group of the last one; 0 before the first."""
        last = self.state.last_share
        if last is None:
            return 0
        have, threshold = self.state.group_status(last.group_index)
        return max(0, int(threshold) - int(have))

    @property
    def groups_needed(self) -> int:
        """How many more groups are needed: a wallet makes one group, other programs may make several."""
        known = self.state.parameters
        return 0 if known is None else max(0, known.group_threshold - self.state.groups_complete())

    def join(self) -> str:
        """Return the 24 words. Of more shares than needed any that fit together will do: forged ones are left out.

        Raises SHARES_TOO_FEW, and SHARES_CONTRADICT if the digest in the shares fits none of their choices.
        """
        if not self.is_complete:
            raise BlockRobotError("SHARES_TOO_FEW")
        first = self._shares[0]
        choices: Iterable[Sequence[Share]] = (
            [self._shares] if first.group_count > 1 else combinations(self._shares, first.member_threshold)
        )
        for chosen in choices:
            state = RecoveryState()
            for share in chosen:
                state.add_share(share)
            try:
                return str(Mnemonic("english").to_mnemonic(state.recover(_NO_PASSPHRASE)))
            except MnemonicError:
                continue
        raise BlockRobotError("SHARES_CONTRADICT")
