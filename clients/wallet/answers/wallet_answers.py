"""What `blockrobot wallet` answers with `--json` of the wallet itself: made, restored, moved, served."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Height, Hex, Problem, doc


class NewWalletAnswer(Answer, frozen=True, kw_only=True):
    """A wallet that was made."""

    wallet: Annotated[str, doc("The wallet's file")]
    member: Annotated[Hex, doc("The member key")]


class RestoreAnswer(NewWalletAnswer, frozen=True, kw_only=True):
    """A wallet that was made again from its words."""

    words_checked: Annotated[
        bool,
        doc("Whether the network said which words are in force; it is asked only where former words are named"),
    ]


class TransferAnswer(Answer, frozen=True, kw_only=True):
    """Visits that were given keys of the present words."""

    transferred: Annotated[list[Hex], doc("Visits that have a new key now")]
    taken_visits: Annotated[list[Hex], doc("Visits that obey somebody else's key")]
    stuck_visits: Annotated[list[Hex], doc("Visits that can be given no other key any more")]
    ended_shares: Annotated[
        list[Hex], doc("Shares that this wallet had no note of, ended by this; see `--keep-shares`")
    ]


class RotateAnswer(TransferAnswer, frozen=True, kw_only=True):
    """A wallet that has new words."""

    words_file: Annotated[str | None, doc("Where the new words are; null if none was named")]


class LeaveAnswer(Answer, frozen=True, kw_only=True):
    """A membership that ended."""

    height: Annotated[Height | None, doc("The block in which it ended; null if it had ended before")]


class KeyringForgetAnswer(Answer, frozen=True, kw_only=True):
    """A passphrase that is in the keyring no more."""

    wallet: Annotated[str, doc("The wallet's file")]


class KeyringStoreAnswer(KeyringForgetAnswer, frozen=True, kw_only=True):
    """A passphrase that is in the keyring."""

    weak_keyring: Annotated[str | None, doc("The keyring's name; null unless it protects little")]


class UnfinishedRequest(Answer, frozen=True, kw_only=True):
    """What was asked for last on the page and came to nothing."""

    kind: Annotated[str, doc("`consent`, `share`, `revoke`, `erase`, `register` or `export`")]
    error: Annotated[Problem | None, doc("Why; null if it was broken off, or its file was not saved")]


class ServeAnswer(Answer, frozen=True, kw_only=True):
    """The local page, once it is there; the command then runs until it is stopped."""

    url: Annotated[str, doc("The page's address; alone it opens nothing")]
    redirect_file: Annotated[str, doc("The file that opens the page, once")]
    browser_opened: Annotated[bool, doc("Whether a browser was started")]


class ServeEndAnswer(Answer, frozen=True, kw_only=True):
    """Printed at the end only if something that was asked for last on the page came to nothing, or was not begun.

    `ok` is false, and the exit code 1.
    """

    unfinished: Annotated[list[UnfinishedRequest], doc("What came to nothing")]
    not_begun: Annotated[bool, doc("Whether something was asked for last that was not begun")]


ANSWERS: AnswersByCommand = {
    "wallet new": NewWalletAnswer,
    "wallet restore": RestoreAnswer,
    "wallet rotate": RotateAnswer,
    "wallet transfer": TransferAnswer,
    "wallet leave": LeaveAnswer,
    "wallet keyring store": KeyringStoreAnswer,
    "wallet keyring forget": KeyringForgetAnswer,
    "wallet serve": (ServeAnswer, ServeEndAnswer),
}
