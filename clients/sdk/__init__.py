"""Client library: build, sign, submit and verify, trusting no node."""
