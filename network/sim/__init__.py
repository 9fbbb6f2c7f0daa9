"""Whole networks in one process: production nodes and clients on a virtual clock, network, disk. One seed, one history."""
