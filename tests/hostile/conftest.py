"""Programs are measured with little to collect."""

from tests.frozen_heap import frozen_heap

__all__ = ["frozen_heap"]
