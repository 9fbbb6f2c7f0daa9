"""The corpus, a module for each kind of attack."""
