"""What robot, wallet and custodian share: vouchers, owner keys, commitments, envelopes."""
