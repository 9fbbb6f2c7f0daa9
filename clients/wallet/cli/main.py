"""`blockrobot wallet`: the wallet on the command line."""

# ruff: noqa: E501 - a table reads better in long lines

from __future__ import annotations

from pathlib import Path

import click

from clients.sdk.terminal.lazy_group import LazyCommand
from clients.wallet.cli.group_options import place_wallet, wallet_options
from clients.wallet.cli.translated_help import TranslatedGroup

_COMMANDS = {
    "audit": LazyCommand(
        "clients.wallet.commands.audit_commands:audit", "Show everything that happened to your records, in order."
    ),
    "confirm-deleted": LazyCommand(
        "clients.wallet.commands.inbox_commands:confirm_deleted",
        "Tell the owner that you have deleted your copies of what was erased, ended or denied since it was shared.",
    ),
    "consent": LazyCommand(
        "clients.wallet.commands.consent_commands:consent",
        "Give, refuse and withdraw consent to being recorded; see what you said.",
    ),
    "correct": LazyCommand(
        "clients.wallet.commands.rights_commands:correct",
        "Say what is wrong with a visit or records. It stands beside them on the chain; nothing is changed.",
    ),
    "erase": LazyCommand(
        "clients.wallet.commands.erase_commands:erase",
        "Erase records, or single pictures of one. Keys are destroyed first; this cannot be undone.",
    ),
    "erasures": LazyCommand(
        "clients.wallet.commands.erase_commands:erasures",
        "Show what you asked to erase, which custodians have confirmed it, and which are overdue.",
    ),
    "export": LazyCommand(
        "clients.wallet.commands.export_commands:export",
        "Take along what the network holds of you: a ZIP of pictures, JSON and proofs that anybody can check offline.",
    ),
    "guardians": LazyCommand(
        "clients.wallet.commands.account.guardians_commands:guardians",
        "Let people you trust bring your wallet back together if you lose it. Without a command: who they are.",
    ),
    "handle": LazyCommand(
        "clients.wallet.commands.share_commands:handle",
        "Show your own handle. Whoever is to share something with you needs it; it is no secret.",
    ),
    "inbox": LazyCommand(
        "clients.wallet.commands.inbox_commands:inbox",
        "Show what was shared with you and what became of it since, and what is wrong with your own visits.",
    ),
    "keyring": LazyCommand(
        "clients.wallet.commands.account.keyring_commands:keyring",
        "Keep this wallet's passphrase in the system's keyring, or take it out again.",
    ),
    "leave": LazyCommand(
        "clients.wallet.commands.account.rotate_commands:leave",
        "End your membership. Says what stays and what goes, and asks.",
    ),
    "lift": LazyCommand(
        "clients.wallet.commands.rights_commands:lift",
        "Lift a restriction. What has outlived its time under it is erased at once.",
    ),
    "look": LazyCommand(
        "clients.wallet.commands.inbox_commands:look",
        "Look at what was shared with you (GRANT, by `blockrobot wallet inbox`): all of it, or these records.",
    ),
    "mandates": LazyCommand(
        "clients.wallet.commands.mandates_commands:mandates",
        "See who acts for you and what was done in your name; accept to act for somebody; end it.",
    ),
    "new": LazyCommand(
        "clients.wallet.commands.account.new_commands:new",
        "Make a new wallet and show its 24 words, this once. Write them down: they are the wallet.",
    ),
    "notice": LazyCommand(
        "clients.wallet.commands.notice_commands:notice",
        "Show what your organisation tells you about your data, and what changed since you consented.",
    ),
    "object": LazyCommand(
        "clients.wallet.commands.rights_commands:object_to",
        "Object to a purpose: nothing more is recorded of you for it, and nothing that was is released for it.",
    ),
    "probe": LazyCommand(
        "clients.wallet.commands.audit_commands:probe",
        "Ask every custodian for a record that is not this wallet's, and say how each refuses (for demonstrations).",
        hidden=True,
    ),
    "receipts": LazyCommand(
        "clients.wallet.commands.receipts_commands:receipts",
        "Show the receipts whose proofs this wallet keeps, each checked here. No node is asked: it works without a network.",
    ),
    "records": LazyCommand(
        "clients.wallet.commands.records_commands:records",
        "List what was recorded of you, proven against the chain: all, or what fits.",
    ),
    "register": LazyCommand(
        "clients.wallet.commands.notice_commands:register",
        "Register with the CODE on your card, and consent to the purposes named, by the depth camera.",
    ),
    "restore": LazyCommand(
        "clients.wallet.commands.account.new_commands:restore",
        "Make the wallet again from its 24 words. Your visits are found again on the chain.",
    ),
    "restrict": LazyCommand(
        "clients.wallet.commands.rights_commands:restrict",
        "Keep records as they are, and let nobody but you see them, until you lift it.",
    ),
    "revoke": LazyCommand(
        "clients.wallet.commands.share_commands:revoke",
        "End what you shared (GRANT: the beginning of its name, by `blockrobot wallet shares`). At once, and for good.",
    ),
    "rotate": LazyCommand(
        "clients.wallet.commands.account.rotate_commands:rotate",
        "Get new words after a theft: whoever has the old ones sees, decides and erases nothing any more.",
    ),
    "serve": LazyCommand(
        "clients.wallet.commands.serve_commands:serve",
        "Open your wallet as a page in your browser, for you alone: it is served on this machine, and keys stay here.",
    ),
    "share": LazyCommand(
        "clients.wallet.commands.share_commands:share",
        "Share records of one visit with a member of the staff or an officer, for a purpose and a time.",
    ),
    "shares": LazyCommand(
        "clients.wallet.commands.share_commands:shares",
        "Show what you share, with whom, until when, who looked and when, and who says that copies are deleted.",
    ),
    "transfer": LazyCommand(
        "clients.wallet.commands.account.rotate_commands:transfer",
        "Give visits that came late, under former words, a key of the present ones.",
    ),
    "verify": LazyCommand(
        "clients.wallet.commands.view_commands:verify",
        "Check records against the chain on this machine, trusting no node, and put the verdict on the chain.",
    ),
    "view": LazyCommand(
        "clients.wallet.commands.view_commands:view",
        "Fetch, check and decrypt records (all if none is named) and write them as pictures, labels and sounds.",
    ),
    "wrong-person": LazyCommand(
        "clients.wallet.commands.rights_commands:wrong_person",
        "Say that a visit (the beginning of its name) shows somebody else. Nobody sees it from then on, you neither.",
    ),
}


@click.group(cls=TranslatedGroup, places=_COMMANDS)
@wallet_options
@click.pass_context
def wallet(ctx: click.Context, profile: str, wallet_dir: Path | None, genesis: Path | None) -> None:
    """See, check, follow and erase what robots recorded of you.

    Example: blockrobot wallet new; blockrobot wallet register BR1-...; blockrobot wallet records
    """
    ctx.obj = place_wallet(profile, wallet_dir, genesis)
