"""Follows people from frame to frame, and tells which of them wears which tag, by distances and bearings."""
