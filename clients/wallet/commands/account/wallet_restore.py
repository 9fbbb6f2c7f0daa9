"""Restores a wallet from present and former mnemonics; works offline, unchecked."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

from clients.sdk.passphrase import PassphraseCost
from clients.wallet.cli.wallet_context import run_made
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import derive_keys
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError

CHECK_MAX_S = 5.0


def read_words(text: str) -> str:
    """Return the words normalised. Raises WORDS_INVALID."""
    derive_keys(text)
    return " ".join(text.lower().split())


def require_distinct(words: str, former: Sequence[str]) -> None:
    """Raise WORDS_REPEATED if any mnemonic occurs twice."""
    if words in former:
        raise refusal("WORDS_REPEATED", "words_same")
    if len(set(former)) != len(former):
        raise refusal("WORDS_REPEATED", "words_twice")


def restore_wallet(
    path: Path, words: str, former: Sequence[str], passphrase: str, cost: PassphraseCost | None, genesis_path: Path
) -> bool:
    """Create the wallet file; return whether the network confirmed which mnemonic is in force.

    Raises WORDS_REPEATED, WALLET_EXISTS, WORDS_SWAPPED (then no file is left).
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
