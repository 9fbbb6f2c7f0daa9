"""Who signs a call and opens the session: officer, member or wallet."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from clients.sdk.new_files import require_seen
from clients.sdk.terminal.terminal import FILE, home_folder
from clients.wallet.cli.wallet_context import read_passphrase
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import derive_keys
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import as_one, folder_option
from network.cli.governance.governance_signer import (
    Signer,
    admin_keys,
    open_network,
    read_private_key,
)
from network.provisioning.new_organisation import ADMIN_KEY_FILE

FindSigners = Callable[[], list[Signer]]
OFFICES = ("", "admin", "registrar")


def get_signers(
    folder: Path | None, officer: str | None, key_file: Path | None, wallet_profile: str | None
) -> list[Signer]:
    """Return the named signer, else every admin whose key is in the folder.

    Raises ORGANISATION_KEY_NOT_FOUND, CLUSTER_NOT_RUNNING, KEY_INVALID, and wallet errors.
    """
    place, genesis = open_network(folder)
    if sum(item is not None for item in (officer, key_file, wallet_profile)) > 1:
        raise click.UsageError("Say once who signs: --as, --key or --wallet.")
    if key_file is not None:
        return [Signer(place, genesis, key_file.stem, read_private_key(key_file))]
    if wallet_profile is not None:
        path = home_folder() / "wallets" / f"{wallet_profile}.wallet"
        if not path.exists():
            raise BlockRobotError("WALLET_NOT_FOUND", f"There is no wallet at {path}.")
        words = Keystore.open(path, read_passphrase()).content.words
        return [Signer(place, genesis, wallet_profile, derive_keys(words).identity)]
    if officer is not None:
        organisation, _, role = officer.partition("/")
        path = place / "organisations" / organisation / f"{role or 'admin'}.key"
        known = sorted(folder.name for folder in (place / "organisations").glob("*") if folder.is_dir())
        if organisation not in known or role not in OFFICES:
            require_seen(place / "organisations", path.name, organisation)
            there = ", ".join(known) or "none"
            raise BlockRobotError(
                "ORGANISATION_KEY_NOT_FOUND", f"There is no key of {officer!r} in {place}; organisations: {there}."
            )
        return [Signer(place, genesis, officer, read_private_key(path))]
    found = [Signer(place, genesis, name, read_private_key(path)) for name, path in admin_keys(place).items()]
    if not found:
        require_seen(place / "organisations", ADMIN_KEY_FILE)
        raise BlockRobotError("ORGANISATION_KEY_NOT_FOUND", f"There is no key in {place / 'organisations'}.")
    return found


def take_signer(signers: list[Signer]) -> Signer:
    if len(signers) > 1:
        names = " | ".join(signer.name for signer in signers)
        raise click.UsageError(f"Say who signs: --as {names} (or --key FILE, --wallet PROFILE).")
    return signers[0]


def _later(folder: Path | None, officer: str | None, key_file: Path | None, wallet_profile: str | None) -> FindSigners:
    return partial(get_signers, folder, officer, key_file, wallet_profile)


signer_options = as_one(
    "find",
    _later,
    folder_option,
    click.option(
        "--as", "officer", metavar="ORG[/ROLE]", help="An organisation's admin, or its registrar as ORG/registrar."
    ),
    click.option("--key", "key_file", type=FILE, help="A key file of raw 32 bytes."),
    click.option("--wallet", "wallet_profile", metavar="PROFILE", help="The person whose wallet this is."),
)
