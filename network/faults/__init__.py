"""Injects faults into a running local network, and repairs them."""
