"""Deterministic consensus rules; pure: no I/O, clock, randomness or asyncio."""
