"""All mutants, in the order of the README's table."""

from __future__ import annotations

from tests.sim.mutants.deciding import DECIDING
from tests.sim.mutants.flooding import FLOODING
from tests.sim.mutants.following import FOLLOWING
from tests.sim.mutants.keeping import KEEPING
from tests.sim.mutants.mutant import Mutant, Schedule
from tests.sim.mutants.remembering import REMEMBERING
from tests.sim.mutants.speaking import SPEAKING
from tests.sim.mutants.storing import STORING

MUTANTS: tuple[Mutant, ...] = (*SPEAKING, *DECIDING, *REMEMBERING, *FOLLOWING, *STORING, *FLOODING, *KEEPING)

SCHEDULES: tuple[Schedule, ...] = tuple({mutant.schedule.name: mutant.schedule for mutant in MUTANTS}.values())
