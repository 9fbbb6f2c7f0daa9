"""`python -I -m contracts.kit.worker`: executes test chains in the nodes' sandbox."""

from __future__ import annotations

import os
import signal
import sys

import msgspec

from consensus.errors import BlockRobotError
from contracts.kit.engine import Call, Engine, Figures, Ran
from contracts.kit.tracing import Trace
from contracts.vm import InternalFault
from contracts.vm.model.faults import ContractSourceError, Diagnostic
from contracts.worker.sandbox import enter_sandbox
from contracts.worker.wire import Pipe, SandboxFeature

MEMORY_MAX_BYTES = 1024**3


class EnterSandbox(msgspec.Struct, frozen=True, tag=True):
    """The first request: close the sandbox and return its parts."""


class Deploy(msgspec.Struct, frozen=True, tag=True):
    """Activate a source on a chain; the parent chooses `chain`."""

    chain: int
    source: str
    name: str


class Withdraw(msgspec.Struct, frozen=True, tag=True):
    """Restore a contract's previous version."""

    chain: int
    name: str


class Run(msgspec.Struct, frozen=True, tag=True):
    """Make a call."""

    chain: int
    call: Call
    keep: bool


class MakeTrace(msgspec.Struct, frozen=True, tag=True):
    """Trace a call without keeping its writes."""

    chain: int
    call: Call
    who: str


class ReadState(msgspec.Struct, frozen=True, tag=True):
    """Read a contract's storage and the state root."""

    chain: int
    contract: str


class ReadFigures(msgspec.Struct, frozen=True, tag=True):
    """Read the figures of a chain's sources."""

    chain: int


class Forget(msgspec.Struct, frozen=True, tag=True):
    """Forget a chain."""

    chain: int


class Answer(msgspec.Struct, frozen=True):
    """The answer; each request fills its own fields."""

    parts: tuple[SandboxFeature, ...] = ()
    migrates_by: str = ""
    ran: Ran | None = None
    trace: Trace | None = None
    rows: list[tuple[bytes, bytes]] = []
    state_root: bytes = b""
    figures: list[Figures] = []
    problems: list[Diagnostic] = []
    refused: tuple[str, str] | None = None
    """Code and detail of an error."""


Request = EnterSandbox | Deploy | Withdraw | Run | MakeTrace | ReadState | ReadFigures | Forget
REQUESTS: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)
ANSWERS: msgspec.msgpack.Decoder[Answer] = msgspec.msgpack.Decoder(Answer)


def answer(engines: dict[int, Engine], request: Request) -> Answer:
    try:
        return _answer(engines, request)
    except ContractSourceError as error:
        return Answer(problems=list(error.diagnostics))
    except BlockRobotError as error:
        return Answer(refused=(error.code, error.detail))
    except InternalFault as error:
        return Answer(refused=("CONTRACT_WORKER_FAILED", str(error)))


def _answer(engines: dict[int, Engine], request: Request) -> Answer:
    if isinstance(request, EnterSandbox):
        return Answer(parts=enter_sandbox((), MEMORY_MAX_BYTES))
    if isinstance(request, Forget):
        engines.pop(request.chain, None)
        return Answer()
    engine = engines.get(request.chain)
    if engine is None:
        engine = engines[request.chain] = Engine()
    found = Answer()
    match request:
        case Deploy():
            found = Answer(migrates_by=engine.deploy(request.source, request.name))
        case Withdraw():
            engine.withdraw(request.name)
        case Run():
            found = Answer(ran=engine.run(request.call, keep=request.keep))
        case MakeTrace():
            found = Answer(trace=engine.trace(request.call, request.who))
        case ReadState():
            rows, root = engine.read_state(request.contract)
            found = Answer(rows=rows, state_root=root)
        case ReadFigures():
            found = Answer(figures=engine.figures())
    return found


def main() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.umask(0o077)
    pipe, engines, is_sandboxed = Pipe(0, 1), dict[int, Engine](), False
    try:
        while True:
            request = pipe.receive(REQUESTS)
            is_sandboxed = is_sandboxed or isinstance(request, EnterSandbox)
            if not is_sandboxed:
                return 2
            pipe.send(answer(engines, request))
    except EOFError:
        return 0


if __name__ == "__main__":
    sys.exit(main())
