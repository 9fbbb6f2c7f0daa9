"""Makes a wallet again from words in force and the former ones, and notices where they were mixed up.

Whose words are in force only the network knows; without it a wallet is made all the same.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

from clients.sdk.passphrase import PassphraseCost
from clients.wallet.cli.wallet_context import run_made
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.present.translations import refusal
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import derive_keys
from consensus.errors import BlockRobotError

CHECK_MAX_S = 5.0


def read_words(text: str) -> str:
    """Return words in their one form. Raises WORDS_INVALID."""
    derive_keys(text)
    return " ".join(text.lower().split())


def require_distinct(words: str, former: Sequence[str]) -> None:
    """Raise WORDS_REPEATED if any words are named twice: each replaces others, and nobody's replace themselves."""
    if words in former:
        raise refusal("WORDS_REPEATED", "words_same")
    if len(set(former)) != len(former):
        raise refusal("WORDS_REPEATED", "words_twice")


def restore_wallet(
    path: Path, words: str, former: Sequence[str], passphrase: str, cost: PassphraseCost | None, genesis_path: Path
) -> bool:
    """Make the wallet file; tell whether the network could say which words are in force (asked if there are former ones).

    Raises WORDS_REPEATED, WALLET_EXISTS; and WORDS_SWAPPED if former words are those of a member, after which there is no
    file.
    """
    require_distinct(words, former)
    store = Keystore.create(path, words, passphrase, cost, former=former)
    if not former:
        return False
    try:
        run_made(store, genesis_path, _require_in_force)
    except BlockRobotError as error:
        if error.code == "WORDS_SWAPPED":
            path.unlink()
            raise
        return False
    return True


async def _require_in_force(opened: Wallet) -> None:
    try:
        async with asyncio.timeout(CHECK_MAX_S):
            await opened.require_registered()
    except TimeoutError:
        raise BlockRobotError("NODE_UNREACHABLE") from None
    except BlockRobotError as error:
        if error.code != "NOT_REGISTERED":  # words of nobody yet are as good as any
            raise
