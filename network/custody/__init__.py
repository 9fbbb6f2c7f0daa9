"""Custody over a whole network: what its custodians say, and what can be found of a record."""
