"""The cluster console: a page of this machine that shows a network, breaks it on purpose, and keeps what happened.

`looking.py` asks the nodes, `moments.py` makes one moment's picture of what they said, `rounds.py` joins their words of
each round, `chronicle.py` says what is new, `recorder.py` keeps all of it within a limit, `export.py` writes a run as one
file, `live.py` and `routes.py` serve it. Pure but for looking, live and routes.
"""
