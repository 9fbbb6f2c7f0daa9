"""The chain's settings, as the organisations decide them together. Must never take a value that stops the chain.

The values in force are in the contract `producers`, as part of the epoch; the proposals in `membership`. What custodians
take of robots, and how many of them keep a clip, is here alone, since no block depends on it: quota/name -> value, its
default while nobody decided it.
"""

RANGES = {
    "base_timeout_ms": [50, 60000],
    "timeout_cap_ms": [1000, 60000],
    "heartbeat_ms": [1, 3600000],
    "min_block_interval_ms": [0, 59999],
    "max_clock_drift_ms": [500, 60000],
    "blocks_per_turn": [1, 100],
    "max_producers": [1, 21],
}
QUOTAS = {
    "robot_staged_max_mib": [1, 1048576, 512],
    "robot_staged_max_count": [1, 1000000, 4096],
    "robot_day_max_mib": [1, 1073741824, 204800],
    "organisation_staged_max_mib": [1, 1048576, 8192],
    "organisation_staged_max_count": [1, 1000000, 65536],
    "organisation_day_max_mib": [1, 1073741824, 2097152],
    "custody_copies": [0, 64, 0],
}
INTERVAL_MAX_MS = 60000
INTERVAL = "interval:"
INTERVAL_MAX_DIGITS = 5
TIMEOUTS = ("base_timeout_ms", "timeout_cap_ms", "min_block_interval_ms")
NAMES = (
    "base_timeout_ms",
    "timeout_cap_ms",
    "heartbeat_ms",
    "min_block_interval_ms",
    "max_clock_drift_ms",
    "blocks_per_turn",
    "production",
    "max_producers",
)


def check_production(value: int | str):
    require(isinstance(value, str), "VALUE_WRONG", "The production is a text.")
    require(value != "manual", "VALUE_WRONG", "A network of many stands still with manual production; it is for emulators.")
    if value == "on-demand":
        return
    digits = value[len(INTERVAL):]
    known = value.startswith(INTERVAL) and digits.isdigit() and len(digits) <= INTERVAL_MAX_DIGITS
    require(known, "VALUE_WRONG", "The production is on-demand or interval:MS.")
    interval_ms = int(digits)
    require(0 < interval_ms and interval_ms <= INTERVAL_MAX_MS, "VALUE_WRONG", "An interval is 1 to 60000 ms.")


def check(name: str, value: int | str):
    """Refuse a value out of its range, also in view of the others that are in force."""
    require(name in NAMES or name in QUOTAS, "SETTING_UNKNOWN", "There is no such setting.")
    if name == "production":
        check_production(value)
        return
    require(isinstance(value, int), "VALUE_WRONG", "The setting is a whole number.")
    if name in QUOTAS:
        least, most, _default = QUOTAS[name]
    else:
        least, most = RANGES[name]
    require(least <= value and value <= most, "VALUE_WRONG", f"The setting is {least} to {most}.")
    alone = name == "custody_copies" and value == 1
    require(not alone, "VALUE_WRONG", "A clip at one custodian alone would be lost with it: keep two copies, or 0 for the default.")
    if name not in TIMEOUTS:
        return
    in_force = call("producers", "settings_in_force")
    in_force[name] = value
    fits = in_force["timeout_cap_ms"] >= in_force["base_timeout_ms"]
    require(fits, "VALUE_WRONG", "timeout_cap_ms must not be below base_timeout_ms; change the other one first.")
    fits = in_force["min_block_interval_ms"] < in_force["base_timeout_ms"]
    require(fits, "VALUE_WRONG", "min_block_interval_ms must be below base_timeout_ms, or every round would be given up.")


def require_direct():
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")


@export
def propose(name: str, value: int | str):
    """Propose a value; its proposer stands behind it. Who may call: an admin of an active organisation."""
    require_direct()
    check(name, value)
    if call("membership", "propose_setting", name, value):
        take_effect(name, value)


@export
def approve(proposal_id: bytes):
    """Stand behind a proposal; with a majority it takes effect. Who may call: an admin of an active organisation."""
    require_direct()
    reached, name, value = call("membership", "approve_setting", proposal_id)
    if reached:
        check(name, value)
        take_effect(name, value)


def take_effect(name: str, value: int | str):
    if name in QUOTAS:
        state.put(b"quota/" + name.encode(), value)
    else:
        call("producers", "change_setting", name, value)
    emit("changed", {"name": name, "value": value, "height": ctx.height})


@view
def names() -> list:
    """Return the names of the settings that organisations may change."""
    return list(NAMES) + list(QUOTAS)


@view
def in_force() -> dict:
    """Return all settings by name."""
    values = call("producers", "settings_in_force")
    for name in QUOTAS:
        values[name] = state.get(b"quota/" + name.encode(), QUOTAS[name][2])
    return values
