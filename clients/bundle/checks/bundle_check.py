"""Check a bundle offline, without node, wallet or network."""

from __future__ import annotations

import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from clients.bundle import documents as doc
from clients.bundle import layout
from clients.bundle.checks.consent_receipts import CheckedReceipt
from clients.bundle.checks.frame_check import ABSENT, ERASED, UNDRAWABLE, is_same_file
from clients.bundle.container import BundleReader
from clients.bundle.proving import (
    SIGN_TAG,
    Heard,
    Proofs,
    Proven,
    build_documents,
    first_files,
    fixed_files,
    known_form,
    never_heard,
    proof_files,
    prove,
    sign_parts,
    walk_visits,
)
from clients.sdk.terminal.terminal import pluralize
from consensus.chain.genesis import Genesis, genesis_from_json, genesis_to_json
from consensus.errors import BlockRobotError
from consensus.primitives.keys import recover
from consensus.rights.consent_receipts import REFUSED, WITHDRAWN
from consensus.state.consent import GIVEN
from consensus.visible_text import escape_controls

VISITS_MAX_COUNT = 9_999
TEXT_MAX_CHARS = 500
RECEIPTED = frozenset((GIVEN, REFUSED, WITHDRAWN))
"""Words on consent of which there are receipts that both sides sign; of an objection there is none."""
_OWN_CODES = frozenset(("BUNDLE_INVALID", "BUNDLE_UNPROVEN", "BUNDLE_OTHER_CHAIN"))
_FORM_ERRORS = (KeyError, TypeError, AttributeError, ValueError, IndexError, OverflowError, RecursionError)


@dataclass(frozen=True, slots=True)
class Verdict:
    """A sound bundle's proofs, as of `as_of_height` at least; `is_anchored`: against the reader's genesis."""

    manifest: doc.Manifest
    is_anchored: bool
    as_of_height: int
    as_of_ms: int
    newest_height: int
    epochs: int
    visits: tuple[doc.VisitDocument, ...]
    consents: doc.ConsentsDocument
    events: int
    accesses: int
    erasures: int
    signers: tuple[bytes, ...]
    signed: tuple[CheckedReceipt, ...]

    @property
    def records(self) -> list[doc.RecordDocument]:
        return [record for visit in self.visits for record in visit.records]

    @property
    def frames(self) -> list[doc.FrameDocument]:
        return [frame for record in self.records for frame in record.frames]

    @property
    def visits_of_member(self) -> tuple[int, ...]:
        """Visits with a record shown to be sealed to the member."""
        return tuple(visit.number for visit in self.visits if any(record.metadata_proved for record in visit.records))


def verify_bundle(path: Path, expected: Genesis | bytes | None = None, heard: Heard = never_heard) -> Verdict:
    """Check a bundle against genesis file or block id. Raises BUNDLE_INVALID, BUNDLE_UNPROVEN, BUNDLE_OTHER_CHAIN,
    OSErrors.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise BlockRobotError("BUNDLE_INVALID", f"{path} is no file.")
    with path.open("rb") as file:
        try:
            return _Check(file, path.stat().st_size, expected, heard).run()
        except BlockRobotError as error:
            if error.code in _OWN_CODES:
                raise BlockRobotError(error.code, printable(error.detail)) from None
            raise BlockRobotError("BUNDLE_UNPROVEN", printable(f"{error.detail} ({error.code})")) from None
        except _FORM_ERRORS as error:
            raise known_form(error) from None


def printable(text: str) -> str:
    """Return untrusted text without control characters, bounded."""
    return escape_controls(text[:TEXT_MAX_CHARS], "")[:TEXT_MAX_CHARS]


def name_visits(numbers: Sequence[int]) -> str:
    """Return `visit 1 is` or `visits 1-3, 7 are`."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and runs[-1][-1] == number - 1:
            runs[-1][1:] = [number]
        else:
            runs.append([number])
    named = ", ".join("-".join(map(str, run)) for run in runs)
    return f"visit {named} is" if len(numbers) == 1 else f"visits {named} are"


class _Stored:
    def __init__(self, reader: BundleReader) -> None:
        self._reader = reader
        self._last: tuple[bytes, bytes | None] = (b"", None)

    def committed(self, name: str, record_id: bytes, index: int) -> bytes:  # noqa: ARG002
        return self._reader.read(name, layout.RENDITION_MAX_BYTES)

    def background(self, digest: bytes) -> bytes | None:
        name = layout.background_name(digest)
        if self._last[0] != digest:
            found = self._reader.read(name, layout.BACKGROUND_MAX_BYTES) if name in self._reader else None
            self._last = (digest, found)
        return self._last[1]


class _Check:
    def __init__(self, file: BinaryIO, size: int, expected: Genesis | bytes | None, heard: Heard) -> None:
        self._heard = heard
        self._expected = expected
        self._reader = BundleReader(file, size, lambda done, of: heard("the file", done, of))
        self._order: list[str] = []

    def run(self) -> Verdict:
        manifest_bytes = self._reader.read(layout.MANIFEST, layout.DOCUMENT_MAX_BYTES)
        manifest = doc.read_document(layout.MANIFEST, manifest_bytes, doc.Manifest)
        self._check_manifest(manifest)
        genesis_text = self._reader.read(layout.GENESIS, layout.DOCUMENT_MAX_BYTES)
        genesis = self._check_genesis(genesis_text, manifest)
        proofs = self._read_proofs(manifest.version)
        proven = prove(genesis, proofs)
        self._check_signatures(genesis.chain_id, manifest_bytes, proven)
        self._expect(first_files())
        visits = self._check_frames(proven)
        self._expect(
            build_documents(proven, visits) + proof_files(proofs) + fixed_files(genesis_text, manifest.version)
        )
        self._order += [layout.MANIFEST, layout.SIGNATURES]
        names, known = [entry.name for entry in self._reader.entries], set(self._order)
        for name in names:
            if name not in known:
                raise BlockRobotError("BUNDLE_UNPROVEN", f"{name} follows from no proof in the bundle.")
        if names != self._order:
            raise BlockRobotError("BUNDLE_INVALID", "The files are not in the order of a bundle.")
        self._check_selection(manifest.selection, proofs)
        return self._verdict(manifest, proven, visits)

    def _check_manifest(self, manifest: doc.Manifest) -> None:
        if manifest.format != doc.FORMAT or manifest.version not in doc.FORMAT_VERSIONS:
            raise BlockRobotError(
                "BUNDLE_INVALID",
                f"The bundle has version {manifest.version} of its format; this program knows 1 and 2.",
            )
        listed = [(entry.name, entry.size, entry.sha256) for entry in manifest.entries]
        there = [
            (entry.name, entry.size, entry.sha256.hex())
            for entry in self._reader.entries
            if entry.name not in {layout.MANIFEST, layout.SIGNATURES}
        ]
        for row, found in zip(listed, there, strict=False):
            if row != found:
                raise BlockRobotError("BUNDLE_INVALID", f"{found[0]} is not what the manifest lists: {row[0]!r:.100}.")
        if len(listed) != len(there):
            raise BlockRobotError("BUNDLE_INVALID", "The bundle has more or fewer files than its manifest lists.")

    def _check_genesis(self, text: bytes, manifest: doc.Manifest) -> Genesis:
        genesis = genesis_from_json(text)
        if genesis_to_json(genesis).encode() != text:
            raise BlockRobotError("BUNDLE_INVALID", "genesis.json is not written as a bundle has it; it was changed.")
        named = (manifest.network, manifest.chain_id, manifest.genesis_id)
        if named != (genesis.network, genesis.chain_id.hex(), genesis.block_id.hex()):
            raise BlockRobotError("BUNDLE_UNPROVEN", "The manifest names another network than genesis.json.")
        expected = self._expected
        wanted = expected.block_id if isinstance(expected, Genesis) else expected
        if wanted is not None and wanted != genesis.block_id:
            sentence = f"The bundle is of the network with genesis {genesis.block_id.hex()}, not {wanted.hex()}."
            if wanted == genesis.chain_id:
                sentence = f"That is the chain id; name the genesis hash, {genesis.block_id.hex()}, or the file."
            raise BlockRobotError("BUNDLE_OTHER_CHAIN", sentence)
        return genesis

    def _read_proofs(self, version: int) -> Proofs:
        size = sum(entry.size for entry in self._reader.entries if entry.name.startswith("proofs/"))
        if size > layout.PROOFS_MAX_BYTES:
            raise BlockRobotError("BUNDLE_INVALID", f"The proofs are larger than {layout.PROOFS_MAX_BYTES} bytes.")
        person = layout.state_proofs_name(0)
        states: list[doc.StateProofs] = []
        while layout.state_proofs_name(len(states) + 1) in self._reader and len(states) < VISITS_MAX_COUNT:
            states.append(self._read(layout.state_proofs_name(len(states) + 1), doc.StateProofs))
        proofs = Proofs(
            chain=self._read(layout.CHAIN_PROOFS, doc.ChainProofs),
            person=self._read(person, doc.StateProofs) if person in self._reader else None,
            visits=tuple(states),
            receipts=self._read(layout.CONSENT_PROOFS, doc.ReceiptProofs),
            openings=self._read(layout.RECORD_OPENINGS, doc.RecordOpenings),
            keys=self._read_extra(version, layout.KEY_HISTORY, doc.KeyHistory, layout.DOCUMENT_MAX_BYTES),
            signed=self._read_extra(
                version, layout.SIGNED_RECEIPTS, doc.SignedReceipts, layout.SIGNED_RECEIPTS_MAX_BYTES
            ),
        )
        if proofs.version != version:
            detail = f"The bundle calls itself version {version}, and has neither former keys nor consent receipts."
            raise BlockRobotError("BUNDLE_INVALID", detail)
        return proofs

    def _read_extra(self, version: int, name: str, kind: type[doc.D], limit_bytes: int) -> doc.D | None:
        if version != doc.FORMAT_VERSION_EXTENDED or name not in self._reader:
            return None
        return self._read(name, kind, limit_bytes)

    def _read(self, name: str, kind: type[doc.D], limit_bytes: int = layout.DOCUMENT_MAX_BYTES) -> doc.D:
        return doc.read_document(name, self._reader.read(name, limit_bytes), kind)

    def _check_signatures(self, chain_id: bytes, manifest: bytes, proven: Proven) -> None:
        signed = self._read(layout.SIGNATURES, doc.Signatures).signatures
        parts = sign_parts(chain_id, manifest)
        keys = []
        for row in signed:
            key = doc.read_bytes(layout.SIGNATURES, row.key)
            if recover(SIGN_TAG, doc.read_bytes(layout.SIGNATURES, row.signature), *parts) != key:
                raise BlockRobotError("BUNDLE_UNPROVEN", "A signature is not of the key that it names.")
            keys.append(key)
        if tuple(keys) != proven.signers:
            raise BlockRobotError("BUNDLE_UNPROVEN", "The bundle is not signed by the keys of all its visits.")

    def _expect(self, files: Sequence[tuple[str, bytes]]) -> None:
        for name, content in files:
            if self._reader.read(name, layout.DOCUMENT_MAX_BYTES) != content:
                raise BlockRobotError("BUNDLE_UNPROVEN", f"{name} is not what follows from the proofs.")
            self._order.append(name)

    def _check_frames(self, proven: Proven) -> tuple[doc.VisitDocument, ...]:
        walk = walk_visits(proven, _Stored(self._reader), self._heard)
        while True:
            try:
                piece = next(walk)
            except StopIteration as end:
                visits: tuple[doc.VisitDocument, ...] = end.value
                return visits
            stored = self._reader.read(piece.name, layout.PICTURE_MAX_BYTES)
            if not is_same_file(piece, stored):
                raise BlockRobotError("BUNDLE_UNPROVEN", f"{piece.name} does not show what the robot committed to.")
            self._order.append(piece.name)

    def _check_selection(self, selection: doc.Selection, proofs: Proofs) -> None:
        has_pictures = any(row.commitment_leaves for row in proofs.openings.records)
        if selection.identity != (proofs.person is not None) or (has_pictures and not selection.pictures):
            raise BlockRobotError("BUNDLE_UNPROVEN", "The manifest says that something was left out, and it is there.")

    def _verdict(self, manifest: doc.Manifest, proven: Proven, visits: tuple[doc.VisitDocument, ...]) -> Verdict:
        times_ms, consents = proven.chain.times_ms, proven.consents
        heights = [visit.proved_from_height for visit in visits] + [consents.proved_at_height] * bool(consents.member)
        as_of = min(heights, default=0)
        return Verdict(
            manifest=manifest,
            is_anchored=self._expected is not None,
            as_of_height=as_of,
            as_of_ms=times_ms.get(as_of, 0),
            newest_height=max(times_ms, default=0),
            epochs=proven.chain.epoch_count,
            visits=visits,
            consents=consents,
            events=sum(len(facts.entries) for facts in proven.visits),
            accesses=sum(len(facts.accesses) for facts in proven.visits),
            erasures=sum(len(facts.erasures) for facts in proven.visits),
            signers=proven.signers,
            signed=proven.signed,
        )


_GONE = (
    (ERASED, "is erased, and gone", "are erased, and gone"),
    (
        ABSENT,
        "could not be had, or was changed at the custodians, and is not in the bundle",
        "could not be had, or were changed at the custodians, and are not in the bundle",
    ),
    (
        UNDRAWABLE,
        "is as the robot committed to it, and cannot be shown as a picture",
        "are as the robot committed to them, and cannot be shown as pictures",
    ),
)
"""What became of pictures of which nothing is proved, as it is said of one and of several."""


def unproved(verdict: Verdict) -> list[str]:
    """Return sentences on what a sound bundle leaves open."""
    lines = []
    if not verdict.is_anchored:
        lines.append("that this is the network it says it is: the genesis file in the bundle is the bundle's own word")
    lines.append("that the robot saw what it committed to, and that there were no other visits than these")
    later = "a visit may have been erased, restricted or denied since"
    lines.append(
        f"what happened after block {verdict.as_of_height}, or of a visit after the block it is told of: {later}"
    )
    partial = [visit for visit in verdict.visits if not visit.is_whole]
    if partial:
        lines.append(
            f"that nothing else happened in {pluralize(len(partial), 'visit')} of which only a part was exported"
        )
    open_metadata = [record for record in verdict.records if record.sensor and not record.metadata_proved]
    if open_metadata:
        lines.append(
            f"sensor, times and counts of {pluralize(len(open_metadata), 'record')}, which are the exporter's word"
        )
    known = [record for record in verdict.records if record.metadata_proved and record.frames]
    miscounted = sum(len(record.frames) != record.frame_count for record in known)
    if miscounted:
        records = pluralize(miscounted, "record")
        lines.append(f"which pictures {records} should hold: the robot counted others than it committed to")
    unnamed = sum(
        record.metadata_proved and record.status == "active" and record.frame_count > 0 and not record.frames
        for record in verdict.records
    )
    if unnamed:
        lines.append(f"anything of the pictures of {pluralize(unnamed, 'record')}, which the bundle does not name")
    for status, of_one, of_many in _GONE:
        count = sum(frame.status == status for frame in verdict.frames)
        if count:
            lines.append(f"anything of {pluralize(count, f'picture, which {of_one}', f'pictures, which {of_many}')}")
    consents = verdict.consents
    if consents.member:
        shown = set(verdict.visits_of_member)
        others = [visit.number for visit in verdict.visits if visit.number not in shown]
        if others:
            lines.append(f"that {name_visits(others)} of the member that it names: no sealed note in the file shows it")
        lines.append("that the history of consents is complete; what holds now is proved")
        lines += _unsigned(verdict)
        if consents.last_word_height > max((word.height for word in consents.history), default=0):
            lines.append(f"what was said last about consent, in block {consents.last_word_height}")
    missing = sum(max(0, visit.missing) for visit in verdict.visits)
    if missing:
        lines.append(
            f"anything of {pluralize(missing, 'record')} that the robot numbered and never brought to the ledger"
        )
    lines.append(
        "when the bundle was made, what was asked for, and why anything is missing: the exporter's word, signed"
    )
    return lines


def _unsigned(verdict: Verdict) -> list[str]:
    if not verdict.signed:
        return []
    lines = ["that the owner read the notices that the consent receipts name, or that they said nothing else"]
    receipted = {each.statement.txid.hex() for each in verdict.signed}
    words = [word for word in verdict.consents.history if word.kind in RECEIPTED]
    count = sum(word.transaction not in receipted for word in words)
    if count:
        statement = f"{count} of the owner's words on consent {'was' if count == 1 else 'were'} said"
        lines.append(f"under which notice {statement}: no receipt by both sides is here")
    return lines
