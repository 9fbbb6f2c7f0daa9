"""The ground floor: canonical bytes, hashes, keys and Merkle proofs. Must never import anything above it."""
