"""Breaks a running local network on purpose, and mends it.

`actions.py` says what can be done, `control.py` does it to a cluster, `plan.py` reads plans (TOML, a seed, timed and
random steps), `run.py` carries a plan out, `profiles.py` names kinds of links. From a test:

    control = FaultControl(cluster)
    await control.carry_out(Partition((("node-1", "node-2"), ("node-3", "node-4"))))
    await control.carry_out(Heal())
"""
