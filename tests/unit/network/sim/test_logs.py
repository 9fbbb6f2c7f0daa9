"""Logs of simulated nodes go nowhere, but for the exceptions in them: nobody foresaw those."""

from __future__ import annotations

import pytest
import structlog

from network.sim.world.sim_cluster import quiet_logs


def test_an_exception_that_code_logs_is_heard_and_nothing_else_is(capsys: pytest.CaptureFixture[str]) -> None:
    log = structlog.get_logger("tried")
    with quiet_logs() as logged:
        log.warning("clips_not_fetched", code="PEER_UNAVAILABLE")
        try:
            raise KeyError("slot")
        except KeyError:
            log.exception("clip_fetch_fault")
        log.critical("ledger_writer_broken", exc_info=ValueError("two heads"))
    assert logged == [
        "logged clip_fetch_fault: KeyError('slot')",
        "logged ledger_writer_broken: ValueError('two heads')",
    ]
    assert capsys.readouterr().out == ""
