"""The published list of sensor codes; same as contract `consent`."""

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
    """Return a sensor's sentence. Raises SENSOR_UNKNOWN."""
    sentence = SENSORS.get(code)
    if sentence is None:
        raise BlockRobotError("SENSOR_UNKNOWN", f"{code[:SENSOR_MAX_CHARS]!r} is no sensor: {', '.join(SENSORS)}.")
    return sentence
