"""Writes a bundle atomically: unnamed where possible, checked as received, mode 0600, then renamed."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NoReturn

from clients.bundle import documents as doc
from clients.bundle import layout
from clients.bundle.checks.bundle_check import Verdict, verify_bundle
from clients.bundle.checks.frame_check import FrameSource
from clients.bundle.container import BundleWriter
from clients.bundle.proving import (
    SIGN_TAG,
    Heard,
    Proofs,
    build_documents,
    first_files,
    fixed_files,
    never_heard,
    proof_files,
    prove,
    sign_parts,
    walk_visits,
)
from clients.sdk import new_files
from consensus.chain.genesis import Genesis, genesis_to_json
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey

_ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True, slots=True)
class Contents:
    """A bundle's contents; `find_key` returns a signer's private key."""

    genesis: Genesis
    proofs: Proofs
    selection: doc.Selection
    problems: tuple[doc.Problem, ...]
    created_at_ms: int
    source: FrameSource
    find_key: Callable[[bytes], PrivateKey]


def write_entries(file: BinaryIO, contents: Contents, heard: Heard = never_heard) -> None:
    """Write deterministically. Raises EXPORT_TOO_LARGE and verification errors."""
    genesis = contents.genesis
    proven = prove(genesis, contents.proofs)
    writer = BundleWriter(file)
    _add_all(writer, first_files())
    walk = walk_visits(proven, contents.source, heard)
    while True:
        try:
            piece = next(walk)
        except StopIteration as end:
            visits: Sequence[doc.VisitDocument] = end.value
            break
        writer.add(piece.name, piece.content)
    proofs = proof_files(contents.proofs)
    if sum(len(content) for _, content in proofs) > layout.PROOFS_MAX_BYTES:
        raise BlockRobotError("EXPORT_TOO_LARGE", "The proofs are larger than 256 MiB.")
    for name, content in build_documents(proven, visits) + proofs:
        if len(content) > layout.DOCUMENT_MAX_BYTES:
            raise BlockRobotError("EXPORT_TOO_LARGE", f"{name} would be larger than 64 MiB.")
        writer.add(name, content)
    _add_all(writer, fixed_files(genesis_to_json(genesis).encode(), contents.proofs.version))
    manifest = doc.write_document(
        doc.Manifest(
            format=doc.FORMAT,
            version=contents.proofs.version,
            network=genesis.network,
            chain_id=genesis.chain_id.hex(),
            genesis_id=genesis.block_id.hex(),
            created_at_ms=contents.created_at_ms,
            selection=contents.selection,
            problems=list(contents.problems),
            entries=[doc.ManifestEntry(entry.name, entry.size, entry.sha256.hex()) for entry in writer.entries],
        )
    )
    writer.add(layout.MANIFEST, manifest)
    parts = sign_parts(genesis.chain_id, manifest)
    signed = [doc.Signature(key.hex(), contents.find_key(key).sign(SIGN_TAG, *parts).hex()) for key in proven.signers]
    writer.add(layout.SIGNATURES, doc.write_document(doc.Signatures(signed)))
    writer.finish()


def _add_all(writer: BundleWriter, files: Sequence[tuple[str, bytes]]) -> None:
    for name, content in files:
        writer.add(name, content)


def require_free(path: Path, *, replace: bool) -> None:
    """Raise FILE_EXISTS or FILE_UNUSABLE unless writable here."""
    hint = "" if replace else " With --force a bundle that is there is replaced."
    new_files.require_free(path, replace=replace, hint=hint)


def write_bundle(path: Path, contents: Contents, *, replace: bool = False, heard: Heard = never_heard) -> Verdict:
    """Raises FILE_EXISTS, EXPORT_TOO_LARGE, BUNDLE_UNPROVEN, OSError, SystemExit."""
    require_free(path, replace=replace)
    temporary = new_files.temporary_beside(path)
    with _ending_in_order():
        file, place = new_files.create_nameless(temporary)
        try:
            with file:
                write_entries(file, contents, heard)
                file.flush()
                verdict = verify_bundle(
                    place, contents.genesis, lambda what, done, of: heard(f"checking {what}", done, of)
                )
                new_files.finish(file, place, temporary)
            new_files.give_name(temporary, path, replace=replace)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    return verdict


@contextmanager
def _ending_in_order() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _ENDINGS}
    heeded = [number for number, handler in before.items() if handler not in {signal.SIG_IGN, None}]

    def end(number: int, _frame: object) -> NoReturn:
        for each in heeded:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)

    try:
        for each in heeded:
            signal.signal(each, end)
        yield
    finally:
        for each in heeded:
            signal.signal(each, before[each])
