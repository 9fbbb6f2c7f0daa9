"""Options naming a wallet, its network and language, and their shell completion."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from clients.sdk.terminal.terminal import FILE, FOLDER, Answers, home_folder, set_confirm_words, set_error_formatter
from clients.wallet.presentation.invocation import DEFAULT_PROFILE, genesis_place
from clients.wallet.presentation.translations import LANGUAGES, WrongUsage, choose_language, error_text, text

_RECORD = re.compile(r"[0-9a-f]{32}")
SHOWN_CHARS = 12
F = TypeVar("F", bound=Callable[..., Any])

KEYRING_KEY = "blockrobot.keyring"


def complete_profiles(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    folder = ctx.params.get("wallet_dir") or home_folder() / "wallets"
    try:
        names = sorted(path.stem for path in Path(folder).glob("*.wallet"))
    except OSError:
        return []
    return [name for name in names if name.startswith(incomplete)]


visit_option = click.option(
    "--visit", "visits", multiple=True, help="A whole visit, by the beginning of its name; may be repeated."
)


def complete_records(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    """Id prefixes of records written below `--out` (`pictures`)."""
    folder = Path(ctx.params.get("out") or "pictures")
    try:
        names = sorted(path.name for path in folder.iterdir() if _RECORD.fullmatch(path.name) and path.is_dir())
    except OSError:
        return []
    found = [name for name in names if name.startswith(incomplete.lower())]
    return [name if len(incomplete) > SHOWN_CHARS else name[:SHOWN_CHARS] for name in found]


def _speak(ctx: click.Context, _: click.Parameter, language: str | None) -> None:
    choose_language(ctx, language)
    set_error_formatter(ctx, error_text)
    words = [text(f"ask.{key}", language=language) for key in ("yes", "no", "hint", "again", "declined")]
    set_confirm_words(ctx, Answers(frozenset(words[0].split()), frozenset(words[1].split()), *words[2:]))


def _use_keyring(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    ctx.meta[KEYRING_KEY] = wanted


def wallet_options(command: F) -> F:
    for option in (
        click.option("--genesis", type=FILE, help="The network's genesis file: all that is trusted."),
        click.option(
            "--keyring",
            is_flag=True,
            envvar="BLOCKROBOT_KEYRING",
            expose_value=False,
            callback=_use_keyring,
            help="Take the passphrase from the system's keyring (see `wallet keyring store`).",
        ),
        click.option("--wallet-dir", type=FOLDER, help="The folder of wallets (default: your own)."),
        click.option(
            "--language",
            type=click.Choice(LANGUAGES),
            expose_value=False,
            is_eager=True,
            callback=_speak,
            help="What to speak (default: BLOCKROBOT_LANGUAGE, else as your system does).",
        ),
        click.option(
            "--profile",
            default=DEFAULT_PROFILE,
            show_default=True,
            shell_complete=complete_profiles,
            help="Which wallet, if there are several.",
        ),
    ):
        command = option(command)
    return command


def for_option(command: F) -> F:
    option = click.option("--for", "whom", help="For a person who cannot, by a mandate: the handle, whole or in short.")
    return option(command)


def place_wallet(profile: str, wallet_dir: Path | None, genesis: Path | None) -> tuple[Path, Path]:
    """Wallet file and genesis file."""
    if not profile.replace("-", "").replace("_", "").isalnum():
        raise WrongUsage("profile")
    return (
        (wallet_dir or home_folder() / "wallets") / f"{profile}.wallet",
        genesis_place(genesis),
    )
