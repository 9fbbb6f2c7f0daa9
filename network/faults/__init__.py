"""Injects faults into a running local network, and repairs them.

`actions.py`: possible actions, `control.py`: applies them, `plan.py`: plans (TOML), `requested.py`: runs what is asked
for. From a test:

    control = FaultControl(cluster)
    await control.carry_out(Partition((("node-1", "node-2"), ("node-3", "node-4"))))
    await control.carry_out(Heal())
"""
