"""`python -m node.main --data-dir DIR`: one node as a process."""

from __future__ import annotations

import argparse
import asyncio
import logging
import logging.handlers
import os
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import structlog

from consensus.errors import BlockRobotError
from node.config import NodeConfig, load_config
from node.node_process import Node
from node.p2p.tls import pass_over_strange_names
from node.process_memory import guard_process
from node.snapshot.restoring import adopt_restored
from node.storage.directory_lock import DirectoryLock

LOG_FILE_MAX_BYTES = 16 * 1024 * 1024
LOG_FILES_KEPT_COUNT = 3


def configure_logging(config: NodeConfig) -> None:
    """To the node's file, to standard output or to both, one JSON object per line."""
    shared: list[structlog.types.Processor] = [
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.format_exc_info,
    ]
    handlers: list[logging.Handler] = []
    if config.log_to != "stdout":
        file = logging.handlers.RotatingFileHandler(
            config.log_path, maxBytes=LOG_FILE_MAX_BYTES, backupCount=LOG_FILES_KEPT_COUNT, encoding="utf-8"
        )
        handlers.append(file)
    if config.log_to != "file":
        handlers.append(logging.StreamHandler(sys.stdout))
    for handler in handlers:
        handler.setFormatter(
            structlog.stdlib.ProcessorFormatter(
                foreign_pre_chain=shared,
                processors=[
                    structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                    structlog.processors.JSONRenderer(),
                ],
            )
        )
    logging.basicConfig(handlers=handlers, level=config.log_level.upper(), force=True)
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *shared,
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=True,
    )


async def run_node(config: NodeConfig, make_node: Callable[[NodeConfig], Node] = Node) -> None:
    """Run until SIGTERM or SIGINT; SIGHUP reloads the certificate. Raises BlockRobotError on failed start."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    stopped = loop.create_task(stop.wait())
    while not stop.is_set():
        async with make_node(config) as node:
            loop.add_signal_handler(signal.SIGHUP, node.reload_certificate)
            begun_anew = loop.create_task(node.begin_anew.wait())
            await asyncio.wait((stopped, begun_anew), return_when=asyncio.FIRST_COMPLETED)
            begun_anew.cancel()
        adopt_restored(config.ledger_dir)


def _new_event_loop() -> asyncio.AbstractEventLoop:
    try:
        import uvloop  # noqa: PLC0415 - not there on every system
    except ImportError:
        return asyncio.new_event_loop()
    loop: asyncio.AbstractEventLoop = uvloop.new_event_loop()
    return loop


def _run(data_dir: Path, make_node: Callable[[NodeConfig], Node]) -> None:
    os.umask(0o077)  # what a node writes is for its own user
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # until the node is open: it would end the process
    guard_process()
    sys.unraisablehook = pass_over_strange_names
    config = load_config(data_dir)
    lock = DirectoryLock(data_dir)
    try:
        configure_logging(config)
        adopt_restored(config.ledger_dir)
        with asyncio.Runner(loop_factory=_new_event_loop) as runner:
            runner.run(run_node(config, make_node))
    finally:
        lock.release()


def run_process(data_dir: Path, make_node: Callable[[NodeConfig], Node] = Node) -> int:
    """Return 0 after a clean stop, else 1."""
    try:
        _run(data_dir.resolve(), make_node)
    except BlockRobotError as error:
        sys.stderr.write(f"{error.code}: {error.detail} {error.next_step}\n")
        return 1
    except Exception as error:  # noqa: BLE001 - the last resort: the traceback goes to the log, not to the user
        structlog.get_logger(__name__).exception("node_failed")
        sys.stderr.write(f"INTERNAL: The node stopped on a fault ({type(error).__name__}); its log has the details.\n")
        return 1
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m node.main", description="Run one BlockRobot node.")
    parser.add_argument("--data-dir", type=Path, required=True, help="the node's data directory")
    parser.add_argument(
        "--restored",
        action="store_true",
        help="the directory or its journal comes from a backup or is lost: sign nothing until it is safe",
    )
    options = parser.parse_args(arguments)
    return run_process(options.data_dir, partial(Node, restored=options.restored))


if __name__ == "__main__":
    sys.exit(main())
