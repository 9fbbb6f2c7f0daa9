"""Custody of recordings under destroyable keys; never holds an open data key."""
