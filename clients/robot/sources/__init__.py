"""Where a robot's events come from. Each source is one module behind the `Source` of `source.py`."""
