"""Vouchers, owner keys, commitments and envelopes shared by robot, wallet and custodian."""
