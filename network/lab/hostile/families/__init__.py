"""The corpus, one module per kind of attack."""
