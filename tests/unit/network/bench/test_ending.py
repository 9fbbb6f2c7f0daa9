"""A measurement that is told to end takes along what it started."""

from __future__ import annotations

import asyncio
import os
import signal

import pytest

from network.bench.processes import run_to_end


class Measurement:
    """Starts something, and is sent signals while it runs and while it cleans up."""

    def __init__(self, during: signal.Signals, cleaning: signal.Signals | None = None) -> None:
        self.during = during
        self.cleaning = cleaning
        self.runs = False

    async def work(self) -> str:
        self.runs = True
        try:
            os.kill(os.getpid(), self.during)
            await asyncio.get_running_loop().create_future()
        finally:
            if self.cleaning is not None:
                os.kill(os.getpid(), self.cleaning)
            for _ in range(5):
                await asyncio.sleep(0)
            self.runs = False
        return "measured"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("again", [None, signal.SIGTERM])
def test_a_signal_ends_it_once_what_it_started_is_stopped(number: signal.Signals, again: signal.Signals | None) -> None:
    outside = signal.signal(number, signal.SIG_DFL)  # whoever started the tests may have had it ignored
    try:
        measurement = Measurement(number, again)
        with pytest.raises(SystemExit) as ended:
            run_to_end(measurement.work())
        assert (measurement.runs, ended.value.code) == (False, 128 + number)
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, outside)


def test_a_hang_up_that_is_to_be_ignored_is_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:

        async def work() -> str:
            os.kill(os.getpid(), signal.SIGHUP)
            await asyncio.sleep(0)
            return "measured"

        assert run_to_end(work()) == "measured"
    finally:
        signal.signal(signal.SIGHUP, before)


def test_what_is_cancelled_by_itself_is_no_end_by_a_signal() -> None:
    async def work() -> None:
        raise asyncio.CancelledError

    with pytest.raises(asyncio.CancelledError):
        run_to_end(work())
