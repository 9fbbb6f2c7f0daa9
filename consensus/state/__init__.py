"""Typed state rows, keys and shared queries, one module per contract."""
