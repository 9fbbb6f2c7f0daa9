"""`blockrobot privacy attack`: what our own ledger gives away, found by attacking it."""
