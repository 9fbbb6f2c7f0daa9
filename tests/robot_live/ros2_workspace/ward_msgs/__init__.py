"""A user's own message package, as sourcing a workspace makes it importable."""
