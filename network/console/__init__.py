"""The cluster console: a local page that shows a network, injects faults and records.

Pure except `node_polling.py`, `live.py` and `routes.py`.
"""
