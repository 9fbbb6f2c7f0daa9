"""Which files a bundle has, in which order, and how large each may be."""

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
    """Return where the proofs of a visit are, by its number from 1; number 0 is the person."""
    return f"proofs/state-{number:04d}.json"


def rendition_name(visit: int, record: int, index: int) -> str:
    """Return where a committed frame is: visit and record by their numbers from 1, the frame by its index."""
    return f"committed/{visit:04d}/{record:05d}-{index:02d}.bin"


def background_name(digest: bytes) -> str:
    """Return where a recorded empty frame is, by its SHA-256."""
    return f"backgrounds/{digest.hex()}.png"


_FOLDERS = {"png": "pictures", "rgb.png": "pictures", "rgb.jpg": "pictures", "depth.png": "depth", "wav": "sounds"}


def shown_name(visit: int, record: int, index: int, suffix: str) -> str:
    """Return where what is made of a frame is: sorted by name, a folder plays in the order in which it was recorded.

    The index counts from 0, though people count pictures from 1: `verify` draws these names anew, and refuses others.
    """
    folder = _FOLDERS.get(suffix, "labels")
    return f"{folder}/{visit:04d}/{record:05d}-{index:02d}.{suffix}"
