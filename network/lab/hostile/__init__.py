"""Malicious contracts, and measurements of CPU time per gas."""
