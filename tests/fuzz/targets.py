"""The targets by name. Each is imported and opened when it is wanted: some start whole nodes."""

from __future__ import annotations

import importlib

from tests.fuzz.target import Target

TARGETS = {
    "bundle": "bundle_target:open_bundle",
    "genesis": "bundle_target:open_genesis",
    "peer": "peer_target:open_peer",
    "consensus": "peer_target:open_consensus",
    "recording": "recording_target:open_recording",
    "ros": "ros_target:open_ros",
    "llrp": "llrp_target:open_llrp",
}


def open_target(name: str) -> Target:
    """Open the target of this name."""
    module, _, function = TARGETS[name].partition(":")
    opened: Target = getattr(importlib.import_module(f"tests.fuzz.{module}"), function)()
    return opened
