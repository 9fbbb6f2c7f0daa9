"""Canonical encoding, hashes, keys and Merkle proofs."""
