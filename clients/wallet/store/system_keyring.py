"""Passphrases from the system's keyring, an optional package."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError

SERVICE = "blockrobot-wallet"
_NAMED_BACKEND = "PYTHON_KEYRING_BACKEND"  # how the package keyring lets a person name one
_RECOMMENDED_PRIORITY = 1  # of keyrings, in the package's own terms: what is below encrypts nothing, or badly
_UNFIT_PRIORITY = 0  # what the package takes where it finds nothing that keeps anything


def load_keyring() -> Any:
    """Raises EXTRA_MISSING, KEYRING_UNUSABLE."""
    try:
        package = importlib.import_module("keyring")
    except ImportError:
        raise BlockRobotError(
            "EXTRA_MISSING", "The keyring needs the package keyring: `make install-keyring` in your clone."
        ) from None
    named = os.environ.get(_NAMED_BACKEND)
    if named is not None:
        try:
            package.core.load_keyring(named)
        except Exception:  # noqa: BLE001 - a name leads into others' code, or into none
            raise refusal("KEYRING_UNUSABLE", "keyring_misspelt", setting=_NAMED_BACKEND, name=named) from None
    return package


@contextmanager
def explaining_keyring_errors(key: str) -> Iterator[None]:
    """Raise what a keyring raises as KEYRING_UNUSABLE (`because.KEY`)."""
    try:
        yield
    except BlockRobotError:
        raise
    except Exception as error:  # noqa: BLE001 - no list of what those of other makers raise would be whole
        raise refusal("KEYRING_UNUSABLE", key, failure=type(error).__name__) from None


def find_weak_keyring(package: Any) -> str | None:
    """Return the name of a keyring not recommended by the package, else None.

    Raises KEYRING_UNUSABLE if nobody chose it: the package silently falls back to a readable file.
    """
    front = package.get_keyring()
    # Of several the package makes a chain, which it recommends whatever is in it. The strongest is what takes things.
    ring = max(getattr(front, "backends", None) or [front], key=lambda one: one.priority)
    if ring.priority >= _RECOMMENDED_PRIORITY:
        return None
    name = type(ring).__name__
    if package.core.load_env() is not None or package.core.load_config() is not None:
        return name
    if ring.priority <= _UNFIT_PRIORITY:
        raise refusal("KEYRING_UNUSABLE", "keyring_none")
    setting = f"{_NAMED_BACKEND}={type(ring).__module__}.{name}"
    raise refusal("KEYRING_UNUSABLE", "keyring_weak", name=name, setting=setting)


def store_in_keyring(wallet: Path, passphrase: str) -> str | None:
    """Return the keyring's name if weak. Raises EXTRA_MISSING, KEYRING_UNUSABLE."""
    backend, name = load_keyring(), str(wallet.resolve())
    with explaining_keyring_errors("keyring_took_nothing"):
        weak = find_weak_keyring(backend)
        backend.set_password(SERVICE, name, passphrase)
    with explaining_keyring_errors("keyring_may_have"):
        kept = backend.get_password(SERVICE, name)
    if kept != passphrase:
        raise refusal("KEYRING_UNUSABLE", "keyring_off")
    return weak


def forget_in_keyring(wallet: Path) -> None:
    """Raises EXTRA_MISSING, KEYRING_EMPTY, KEYRING_UNUSABLE."""
    backend, name = load_keyring(), str(wallet.resolve())
    with explaining_keyring_errors("keyring_may_still_have"):
        if backend.get_password(SERVICE, name) is None:
            raise BlockRobotError("KEYRING_EMPTY")
        backend.delete_password(SERVICE, name)


def read_from_keyring(wallet: Path) -> str:
    """Raises EXTRA_MISSING, KEYRING_EMPTY, KEYRING_UNUSABLE."""
    backend = load_keyring()
    with explaining_keyring_errors("keyring_gave_nothing"):
        found = backend.get_password(SERVICE, str(wallet.resolve()))
    if found is None:
        raise BlockRobotError("KEYRING_EMPTY")
    return str(found)
