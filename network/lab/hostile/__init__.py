"""Contracts made to do harm, and programs that measure what gas buys."""
