"""`blockrobot privacy attack`: measures by attacks what our ledger leaks."""
