"""`blockrobot verify`: check an export bundle or consent receipts offline."""

from __future__ import annotations

import re
from pathlib import Path

import click

from clients.bundle.bundle_answers import SignedReceipt, StatedProblem, VerifyBundleAnswer, VerifyReceiptsAnswer
from clients.bundle.checks.bundle_check import Verdict, name_visits, printable, unproved, verify_bundle
from clients.bundle.checks.consent_receipts import CheckedFile, CheckedReceipt, check_file, is_receipt_file
from clients.bundle.checks.frame_check import count_pictures
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, console, load_genesis, pluralize, print_answer, show_progress
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from pages.time_format import format_time

_HASH = re.compile(r"[0-9a-fA-F]{64}", re.ASCII)


def read_genesis(text: str | None) -> Genesis | bytes | None:
    """Return genesis, 32-byte hash or None. Raises GENESIS_INVALID."""
    if text is None:
        return None
    if _HASH.fullmatch(text) and not Path(text).exists():
        return bytes.fromhex(text)
    return load_genesis(Path(text))


def _plain(text: str) -> str:
    return escape(printable(text))


def _bundle_answer(path: Path, verdict: Verdict) -> VerifyBundleAnswer:
    manifest, frames = verdict.manifest, verdict.frames
    return VerifyBundleAnswer(
        file=str(path),
        network=manifest.network,
        chain_id=manifest.chain_id,
        genesis_id=manifest.genesis_id,
        is_anchored=verdict.is_anchored,
        is_complete=not manifest.problems,
        proved_until_height=verdict.as_of_height,
        proved_until_ms=verdict.as_of_ms,
        newest_proof_height=verdict.newest_height,
        visits_proved_until_height=[visit.proved_from_height for visit in verdict.visits],
        epochs=verdict.epochs,
        stated_created_at_ms=manifest.created_at_ms,
        visits=len(verdict.visits),
        records=len(verdict.records),
        metadata_proved=sum(record.metadata_proved for record in verdict.records),
        pictures=count_pictures(frames),
        audit_entries=verdict.events,
        accesses=verdict.accesses,
        erasures=verdict.erasures,
        member=verdict.consents.member,
        visits_of_member=list(verdict.visits_of_member),
        consent_receipts=len(verdict.consents.history),
        signed_consent_receipts=[_signed_receipt(receipt) for receipt in verdict.signed],
        signed_by=[key.hex() for key in verdict.signers],
        stated_problems=[
            StatedProblem(record_id=each.record_id, code=each.code, sentence=each.sentence)
            for each in manifest.problems
        ],
        not_proved=unproved(verdict),
    )


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--genesis", "named", help="The network's genesis file, or its genesis hash: whom you trust, not the file."
)
@command_output
def verify(file: Path, named: str | None, as_json: bool) -> None:
    """Check an export bundle offline: what is proved, against which network, up to which block, and what is not.

    A file of consent receipts (`wallet consent receipts --out`) is known by itself, and checked the same way.

    Example: blockrobot verify my-data.zip --genesis genesis.json

    Exits 0 if everything in the file follows from its proofs, 1 if anything does not or the file is damaged.
    """
    if not file.exists():
        raise BlockRobotError("NOT_FOUND", f"There is no file {file}.")
    if file.is_file() and is_receipt_file(file):
        _tell_receipts(file, check_file(file, read_genesis(named)), as_json=as_json)
        return
    verdict = verify_bundle(file, read_genesis(named), show_progress(quiet=as_json))
    if as_json:
        print_answer(_bundle_answer(file, verdict))
        return
    for line in _lines(verdict):
        console.print(line)


def _as_of(verdict: Verdict) -> list[str]:
    numbers: dict[int, list[int]] = {}
    for visit in verdict.visits:
        numbers.setdefault(visit.proved_from_height, []).append(visit.number)
    lines = [f"  {name_visits(numbers[height])} told as of block {height}" for height in sorted(numbers)]
    if verdict.consents.member:
        lines.append(f"  the member and their consents are told as of block {verdict.consents.proved_at_height}")
    return lines


def _lines(verdict: Verdict) -> list[str]:
    found, manifest = _bundle_answer(Path(), verdict), verdict.manifest
    anchor = "the network that you named" if verdict.is_anchored else "[yellow]the bundle's own word[/yellow]"
    lines = [
        "[green]Everything in this file follows from its proofs.[/green]",
        f"Against which network: {_plain(manifest.network)} ({anchor})",
        f"  chain id      {manifest.chain_id}",
        f"  genesis hash  {manifest.genesis_id}",
        f"Up to which block: {verdict.as_of_height}, of {format_time(verdict.as_of_ms)}"
        f" (the newest proof is of block {verdict.newest_height}; {pluralize(verdict.epochs, 'epoch')} followed)",
        *_as_of(verdict),
        "Proved:",
        f"  - {_recorded(found)}",
        f"  - {pluralize(found.pictures, 'picture, sound or label is', 'pictures, sounds or labels are')} "
        "what the robot committed to",
        f"  - {pluralize(found.audit_entries, 'event')}, {pluralize(found.accesses, 'request')} for access and "
        f"{pluralize(found.erasures, 'erasure')}, with what custodians answered",
        "  - the file is as it was exported, by who holds the keys of these visits "
        f"({pluralize(len(verdict.signers), 'signature')})",
    ]
    if verdict.consents.member:
        phrase = pluralize(found.consent_receipts, "word", "words")
        words = f"{phrase} on consent from after registering, with the chain's receipts"
        lines.append(f"  - the consents of member {verdict.consents.member} are as told; {words}")
        lines += _signed_lines(found.signed_consent_receipts)
        if verdict.visits_of_member:
            named = name_visits(verdict.visits_of_member)
            lines.append(f"  - {named} of that member: robots sealed records to the key that it registered")
    lines.append("Not proved:")
    lines += [f"  - {line}" for line in unproved(verdict)]
    if manifest.problems:
        lines.append("Missing, as its exporter says:")
        lines += [f"  - {_plain(each.record_id) or 'all'}: {_plain(each.sentence)}" for each in manifest.problems]
    return lines


def _recorded(found: VerifyBundleAnswer) -> str:
    visits, records = pluralize(found.visits, "visit"), pluralize(found.records, "record")
    are = "is" if found.visits == 1 else "are"
    if found.records == 1:
        opened = "opened" if found.metadata_proved else "did not open"
        return f"{visits} with {records} {are} on the ledger as told, and the record {opened} as the robot sealed it"
    return (
        f"{visits} with {records} {are} on the ledger as told, "
        f"and {found.metadata_proved} of them opened as the robot sealed them"
    )


def _signed_lines(rows: list[SignedReceipt]) -> list[str]:
    if not rows:
        return []
    whose = f"by the owner and by {_plain(rows[0].organisation)}, which registered them"
    is_one = len(rows) == 1
    phrase = "receipt of consent is signed" if is_one else "receipts of consent are signed"
    agree = "says what the ledger says" if is_one else "say what the ledger says"
    first = f"  - {len(rows)} {phrase} by both sides, {whose}, and {agree}:"
    return [first, *(f"      {_plain(_receipt_line(row))}" for row in rows)]


def _receipt_line(row: SignedReceipt) -> str:
    what, sensors = ", ".join(row.purposes) or "everything", ", ".join(row.sensors) or "every sensor"
    notice = "no notice" if row.notice_version is None else f"notice {row.notice_version}"
    return f"{format_time(row.time_ms)}  {row.status}: {what} by {sensors} (block {row.height}, {notice})"


def _signed_receipt(receipt: CheckedReceipt) -> SignedReceipt:
    statement = receipt.statement
    return SignedReceipt(
        txid=statement.txid.hex(),
        handle=statement.handle.hex(),
        status=statement.status,
        purposes=list(statement.purposes),
        sensors=list(statement.sensors),
        height=statement.height,
        time_ms=statement.time_ms,
        organisation=receipt.organisation,
        node=receipt.node,
        is_registrars=receipt.is_registrars,
        notice_version=None if receipt.published is None else receipt.published.row.version,
    )


_NOT_BY_REGISTRAR = " of some receipts, which an older wallet fetched, that who signed them had registered the owner;"


def _tell_receipts(path: Path, found: CheckedFile, *, as_json: bool) -> None:
    genesis, rows = found.genesis, [_signed_receipt(receipt) for receipt in found.receipts]
    if as_json:
        answer = VerifyReceiptsAnswer(
            file=str(path),
            network=genesis.network,
            chain_id=genesis.chain_id.hex(),
            genesis_id=genesis.block_id.hex(),
            is_anchored=found.is_anchored,
            consent_receipts=len(rows),
            signed_consent_receipts=rows,
        )
        print_answer(answer)
        return
    anchor = "the network that you named" if found.is_anchored else "[yellow]the file's own word[/yellow]"
    console.print(
        f"[green]All {len(rows)} receipts in this file are signed by both sides and stand on the chain.[/green]"
    )
    console.print(f"Against which network: {_plain(genesis.network)} ({anchor})")
    console.print(f"  genesis hash  {genesis.block_id.hex()}")
    for row in rows:
        console.print(_plain(_receipt_line(row)))
    by_other = "" if all(row.is_registrars for row in rows) else _NOT_BY_REGISTRAR
    console.print(
        "Not proved: who the person is, for the file names them by a random handle; that they read the notice;"
        f"{by_other} and whether they said anything more that is not in this file."
    )
