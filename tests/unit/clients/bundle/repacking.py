"""What a forger can do: take a bundle apart, change it, and pack it again, with or without the keys of its visits."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import msgspec

from clients.bundle import documents as doc
from clients.bundle import layout
from clients.bundle.checks.bundle_check import Verdict, verify_bundle
from clients.bundle.container import BundleReader, BundleWriter
from clients.bundle.proving import SIGN_TAG, sign_parts
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey

Files = dict[str, bytes]


def unpack(path: Path) -> Files:
    """The files of a bundle, in order."""
    content = path.read_bytes()
    reader = BundleReader(io.BytesIO(content), len(content))
    return {entry.name: reader.read(entry.name, 1 << 30) for entry in reader.entries}


def pack(files: Files) -> bytes:
    """The files in the form of a bundle, as they are."""
    buffer = io.BytesIO()
    writer = BundleWriter(buffer)
    for name, content in files.items():
        writer.add(name, content)
    writer.finish()
    return buffer.getvalue()


def list_anew(files: Files) -> Files:
    """The files with a manifest that lists them as they are."""
    buffer = io.BytesIO()
    writer = BundleWriter(buffer)
    for name, content in files.items():
        if name not in {layout.MANIFEST, layout.SIGNATURES}:
            writer.add(name, content)
    rows = [doc.ManifestEntry(entry.name, entry.size, entry.sha256.hex()) for entry in writer.entries]
    manifest = msgspec.json.decode(files[layout.MANIFEST], type=doc.Manifest)
    return files | {layout.MANIFEST: doc.write_document(msgspec.structs.replace(manifest, entries=rows))}


def sign_anew(files: Files, genesis: Genesis, find_key: Callable[[bytes], PrivateKey]) -> Files:
    """The files signed by all who signed before: what the bundle's own maker can do."""
    signed = msgspec.json.decode(files[layout.SIGNATURES], type=doc.Signatures).signatures
    parts = sign_parts(genesis.chain_id, files[layout.MANIFEST])
    rows = [doc.Signature(row.key, find_key(bytes.fromhex(row.key)).sign(SIGN_TAG, *parts).hex()) for row in signed]
    return files | {layout.SIGNATURES: doc.write_document(doc.Signatures(rows))}


def judge(path: Path, content: bytes, expected: Genesis | None) -> Verdict | BlockRobotError:
    """What the verifier says of these bytes: any other exception is a failure of the verifier."""
    path.write_bytes(content)
    try:
        return verify_bundle(path, expected)
    except BlockRobotError as refusal:
        error = refusal
    assert error.code.startswith("BUNDLE_"), error
    return error
