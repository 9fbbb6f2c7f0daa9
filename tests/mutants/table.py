"""All mutants, by where they are. `killed_by`: the tests that notice it."""

from __future__ import annotations

from tests.mutants import of_chain, of_clients, of_erasure, of_limits, of_rights
from tests.mutants.dropped_checks import DROPPED_CHECKS
from tests.mutants.mutant import Mutant

MUTANTS: tuple[Mutant, ...] = (
    *DROPPED_CHECKS,
    *of_chain.REPLACED,
    *of_rights.REPLACED,
    *of_erasure.REPLACED,
    *of_limits.REPLACED,
    *of_clients.REPLACED,
)
