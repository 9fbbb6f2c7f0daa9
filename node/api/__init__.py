"""The HTTP interface of one node."""

from __future__ import annotations

from node.api.application import create_api
from node.api.ports import ApiServices

__all__ = ["ApiServices", "create_api"]
