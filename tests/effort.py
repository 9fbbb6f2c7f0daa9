"""How much the searches of the long tier try: TEST_EFFORT times what fits into its hour."""

from __future__ import annotations

import os

EFFORT = int(os.environ.get("TEST_EFFORT", "1"))
EFFORT_OF_ALL = 10
"""From here on, searches that can come to an end try everything."""
