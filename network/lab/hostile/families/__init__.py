"""The corpus, a module for each kind of attack. Must never hold a program without the outcome it must come to."""
