"""The chain's settings, as the organisations decide them together. Must never take a value that stops the chain."""

NAMES = ("base_timeout_ms", "timeout_cap_ms", "heartbeat_ms", "min_block_interval_ms", "max_clock_drift_ms")


@view
def names() -> list:
    """Return the names of the settings that organisations may change."""
    return list(NAMES)
