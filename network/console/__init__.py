"""The cluster console: a local page that shows a network, injects faults and records.

Pure except `looking.py`, `live.py` and `routes.py`.
"""
