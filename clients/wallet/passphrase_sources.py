"""Where a passphrase comes from beside the terminal: the system's keyring, if asked for. Must never import it unasked."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from consensus.errors import BlockRobotError

SERVICE = "blockrobot-wallet"


def load_keyring() -> Any:
    """Return the package that speaks to the system's keyring. Raises EXTRA_MISSING."""
    try:
        return importlib.import_module("keyring")
    except ImportError:
        raise BlockRobotError(
            "EXTRA_MISSING", "The keyring needs the package keyring: `pip install 'blockrobot[keyring]'`."
        ) from None


def read_from_keyring(wallet: Path) -> str:
    """Return a wallet's passphrase from the system's keyring. Raises EXTRA_MISSING, KEYRING_EMPTY, KEYRING_UNUSABLE."""
    backend = load_keyring()
    try:
        found = backend.get_password(SERVICE, str(wallet.resolve()))
    except importlib.import_module("keyring.errors").KeyringError as error:
        raise BlockRobotError("KEYRING_UNUSABLE", f"The keyring gave nothing: {type(error).__name__}.") from None
    if found is None:
        raise BlockRobotError("KEYRING_EMPTY")
    return str(found)
