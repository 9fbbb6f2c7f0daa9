"""A custodian's custody: what it keeps of people, under keys that it can destroy. Must never hold an open data key."""
