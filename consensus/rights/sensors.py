"""The published list of sensors by which people are recorded.

A sensor stands in consents, on the chain, so it is a code from this list; the contract `consent` has the same one.
"""

from __future__ import annotations

from consensus.errors import BlockRobotError

SENSOR_MAX_CHARS = 32

SENSORS: dict[str, str] = {
    "audio": "A microphone.",
    "depth": "A depth camera: distances, no colours.",
    "emotion": "An estimate of how somebody feels.",
    "rgb": "A colour camera.",
}


def require_sensor(code: str) -> str:
    """Return the plain sentence of a sensor. Raises SENSOR_UNKNOWN for a code that is not on the list."""
    sentence = SENSORS.get(code)
    if sentence is None:
        raise BlockRobotError("SENSOR_UNKNOWN", f"{code[:SENSOR_MAX_CHARS]!r} is no sensor: {', '.join(SENSORS)}.")
    return sentence
