"""Whole networks in one process on virtual clock, network and disk; deterministic by seed."""
