"""The ground floor: canonical bytes, hashes, keys and Merkle proofs."""
