"""A year of a hospital in a day: real contracts, ledger and custodians, under a clock that the program drives."""
