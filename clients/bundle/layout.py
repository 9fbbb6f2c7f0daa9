"""Bundle file names, order and size limits."""

from __future__ import annotations

from consensus.limits import CIPHERTEXT_MAX_BYTES

README = "README.txt"
PLAYER = "play.html"
SCHEMA = "schema.json"
GENESIS = "genesis.json"
MANIFEST = "manifest.json"
SIGNATURES = "signatures.json"
VISITS = "data/visits.json"
AUDIT = "data/audit.json"
ACCESS = "data/access.json"
ERASURES = "data/erasures.json"
RIGHTS = "data/rights.json"
CONSENTS = "data/consents.json"
TOLD_RECEIPTS = "data/receipts.json"
CHAIN_PROOFS = "proofs/chain.json"
CONSENT_PROOFS = "proofs/consents.json"
KEY_HISTORY = "proofs/keys.json"
SIGNED_RECEIPTS = "proofs/receipts.json"
RECORD_OPENINGS = "proofs/records.json"

DOCUMENT_MAX_BYTES = 64 * 1024 * 1024
PROOFS_MAX_BYTES = 256 * 1024 * 1024
"""All documents under proofs/ together: a verifier holds them in memory."""
SIGNED_RECEIPTS_MAX_BYTES = 32 * 1024 * 1024
RENDITION_MAX_BYTES = CIPHERTEXT_MAX_BYTES
PICTURE_MAX_BYTES = 64 * 1024 * 1024
BACKGROUND_MAX_BYTES = 16 * 1024 * 1024


def state_proofs_name(number: int) -> str:
    """Return a visit's proofs path, from 1; 0: the person."""
    return f"proofs/state-{number:04d}.json"


def rendition_name(visit: int, record: int, index: int) -> str:
    """Visit and record count from 1, index from 0."""
    return f"committed/{visit:04d}/{record:05d}-{index:02d}.bin"


def background_name(digest: bytes) -> str:
    return f"backgrounds/{digest.hex()}.png"


_FOLDERS = {"png": "pictures", "rgb.png": "pictures", "rgb.jpg": "pictures", "depth.png": "depth", "wav": "sounds"}


def shown_name(visit: int, record: int, index: int, suffix: str) -> str:
    """Index from 0; names sort in recording order."""
    folder = _FOLDERS.get(suffix, "labels")
    return f"{folder}/{visit:04d}/{record:05d}-{index:02d}.{suffix}"
