"""Contracts made to do harm, and programs that measure what gas buys. Must never be reachable by a node."""
