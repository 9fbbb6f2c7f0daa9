"""What `blockrobot wallet guardians` answers with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, UnsetType

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Hex, TimeMs, doc


class GuardianShares(Answer, frozen=True, kw_only=True):
    """A set of shares of the wallet's words. No share is in it: the wallet has none."""

    identifier: Annotated[Count, doc("The number that all shares of a set bear")]
    made_at_ms: Annotated[TimeMs, doc("When it was made; 0: not by this wallet, which came from it")]
    threshold: Annotated[Count, doc("How many guardians are needed")]
    guardians: Annotated[list[str], doc("Their names")]
    handed_over: Annotated[Count, doc("How many of them had their words when it ended")]
    words_in_force: Annotated[bool, doc("Whether it brings the present words back")]


class GuardiansAnswer(Answer, frozen=True, kw_only=True):
    """Who holds shares of the wallet's words."""

    sets: Annotated[list[GuardianShares], doc("Each set of shares")]


class GuardiansSplitAnswer(GuardianShares, frozen=True, kw_only=True):
    """A set of shares that was made."""

    sheets: Annotated[list[str], doc("The sheets that were written")]


class GuardianShare(Answer, frozen=True, kw_only=True):
    """A share of a set."""

    identifier: Annotated[Count, doc("The number that all shares of a set bear")]
    sheet: Annotated[Count, doc("The sheet's number, from 1")]


class GuardiansCheckAnswer(GuardianShare, frozen=True, kw_only=True):
    """A share whose words are whole."""

    threshold: Annotated[Count, doc("How many guardians are needed")]


class GuardiansRecoverAnswer(Answer, frozen=True, kw_only=True):
    """A wallet, or its words, made again from shares."""

    wallet: Annotated[str | UnsetType, doc("The wallet's file; absent with `--words-only`")] = UNSET
    member: Annotated[Hex | UnsetType, doc("The member key; absent with `--words-only`")] = UNSET
    words_checked: Annotated[
        bool | UnsetType,
        doc(
            "Whether the network said which words are in force; it is asked only where former words are named; "
            "absent with `--words-only`"
        ),
    ] = UNSET
    membership: Annotated[
        str | UnsetType,
        doc("What the network says of the words: `member`, `nobody` or `not_asked`; absent with `--words-only`"),
    ] = UNSET
    words_file: Annotated[str | None, doc("Where the words are; null without `--words-file`")]
    left_out: Annotated[list[GuardianShare], doc("Shares that did not fit")]


ANSWERS: AnswersByCommand = {
    "wallet guardians": GuardiansAnswer,
    "wallet guardians list": GuardiansAnswer,
    "wallet guardians split": GuardiansSplitAnswer,
    "wallet guardians check": GuardiansCheckAnswer,
    "wallet guardians recover": GuardiansRecoverAnswer,
}
