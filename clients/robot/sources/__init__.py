"""A robot's event sources, each behind `Source` of `source.py`."""
