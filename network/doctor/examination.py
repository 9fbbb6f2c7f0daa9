"""Examines a network's folder, or one data directory."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import aiohttp

from clients.sdk.terminal.terminal import load_genesis as load_network_genesis
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from network.cluster import Cluster, fetch_status, no_network
from network.cluster_monitor import kept_lines
from network.custody.custody_requests import ask_all
from network.custody.custody_text import failing_sentences, find_upload_problems
from network.doctor import answers as words
from network.doctor.answers import Answer
from network.doctor.data_directory import check_authorities, check_directory
from network.doctor.findings import Finding, in_order
from network.doctor.ledger_probe import LedgerFacts, probe_ledgers
from network.faults.control import FaultControl
from network.provisioning.node_certificates import now_ms
from network.provisioning.node_joining import newest_directory
from network.remote_nodes import OnProgress, RemoteNode, ask_remote_nodes
from node.config import CONFIG_FILE, OPERATOR_HOST, NodeConfig, load_config, load_genesis
from node.storage.directory_lock import LOCK_FILE_NAME, DirectoryLock


async def check_uploads(configs: Sequence[NodeConfig], answers: Sequence[Answer]) -> list[Finding]:
    running = {answer.name for answer in answers if answer.status is not None}
    custodians = [config for config in configs if config.custodian_key_path is not None and config.name in running]
    found = []
    for config, answer in zip(custodians, await ask_all(custodians), strict=True):
        if isinstance(answer, BlockRobotError):
            code = "CUSTODY_FAILING" if answer.code == "STORE_UNAVAILABLE" else "CUSTODY_SILENT"
            found.append(Finding(code, config.name, f"{answer.detail} ({answer.code})"))
        else:
            found += [Finding("CUSTODY_FAILING", config.name, sentence) for sentence in failing_sentences(answer)]
            found += [Finding(code, config.name, sentence) for code, sentence in find_upload_problems(answer)]
    return found


ASK_TIMEOUT_S = 3.0
DRIFT_DEFAULT_MS = 5_000


@dataclass(frozen=True, slots=True)
class Examination:
    """Findings (problems first), nodes examined here and elsewhere, and how far back blocks are kept."""

    nodes: tuple[str, ...]
    findings: tuple[Finding, ...]
    blocks_kept: tuple[str, ...] = ()
    elsewhere: tuple[RemoteNode, ...] = ()

    @property
    def ok(self) -> bool:
        return all(finding.kind.severity != "problem" for finding in self.findings)


def get_data_directories(network: Path) -> list[Path]:
    """Raises CLUSTER_NOT_RUNNING if it is no network's folder."""
    if not (network / "genesis.json").is_file():
        raise no_network(network)
    return sorted(path.parent for path in (network / "nodes").glob(f"*/{CONFIG_FILE}"))


def examine_network(network: Path, progress: OnProgress = lambda *_: None) -> Examination:
    """Raises CLUSTER_NOT_RUNNING, GENESIS_INVALID."""
    directories = get_data_directories(network)
    genesis = load_network_genesis(network / "genesis.json")
    found = examine(directories, genesis, whole=True, progress=progress)
    faults = [] if any(item.code == "CONFIGURATION_WRONG" for item in found.findings) else _faults_on_purpose(network)
    findings = tuple(in_order([*found.findings, *faults]))
    return replace(found, findings=findings)


def _faults_on_purpose(network: Path) -> list[Finding]:
    states = asyncio.run(FaultControl(Cluster(network)).state())
    return [
        Finding("FAULT_ON_PURPOSE", state.name, words_of_fault + ".")
        for state in states
        if state.running
        for words_of_fault in state.describe()
    ]


def examine_node(data_dir: Path) -> Examination:
    return examine([data_dir.resolve()], None, whole=False)


def examine(
    directories: Sequence[Path], genesis: Genesis | None, *, whole: bool, progress: OnProgress = lambda *_: None
) -> Examination:
    """`whole`: they are the complete network, so compare them."""
    findings: list[Finding] = []
    configs = []
    for path in directories:
        config = _load(path, genesis, findings)
        if config is not None:
            configs.append(config)
            genesis = genesis or load_genesis(config)
    if genesis is None:
        return Examination(tuple(path.name for path in directories), tuple(in_order(findings)))
    ledgers = probe_ledgers(configs)
    findings += [
        Finding("LEDGER_FOREIGN" if facts.is_foreign else "LEDGER_DAMAGED", facts.name, facts.trouble)
        for facts in ledgers.values()
        if facts.trouble
    ]
    whole_configs = [config for config in configs if not ledgers[config.name].trouble]
    directory = newest_directory(genesis, whole_configs)
    time_ms = now_ms()
    for config in configs:
        findings += check_directory(config, directory, time_ms)
    findings += check_authorities(directory, time_ms)
    answers = asyncio.run(_ask_all(configs, genesis))
    membership = words.check_membership(answers, directory)
    removed = frozenset(finding.node for finding in membership if finding.code == "NODE_REMOVED")
    findings += asyncio.run(check_uploads(configs, answers))
    here = {path.name for path in directories}
    elsewhere = asyncio.run(ask_remote_nodes(genesis, directory, here, progress)) if whole else []
    findings += [*membership, *words.check_presence(answers, removed), *_check_answers(answers, ledgers, removed)]
    findings += words.check_heights(answers, elsewhere)
    if whole:
        findings += words.check_links(answers, directory)
    kept = kept_lines({answer.name: answer.status for answer in answers})
    names = tuple(path.name for path in directories)
    return Examination(names, tuple(in_order(findings)), tuple(kept), tuple(elsewhere))


def _load(path: Path, genesis: Genesis | None, findings: list[Finding]) -> NodeConfig | None:
    try:
        config = load_config(path)
        own = load_genesis(config)
    except (BlockRobotError, OSError) as error:
        detail = error.detail if isinstance(error, BlockRobotError) else f"{path}: {error.strerror}."
        findings.append(Finding("CONFIGURATION_WRONG", path.name, detail))
        return None
    if genesis is not None and own.chain_id != genesis.chain_id:
        findings.append(Finding("GENESIS_DIFFERS", config.name, f"Its chain id is {own.chain_id.hex()[:16]}..."))
        return None
    return config


async def _ask_all(configs: Sequence[NodeConfig], genesis: Genesis) -> list[Answer]:
    timeout = aiohttp.ClientTimeout(total=ASK_TIMEOUT_S)
    async with aiohttp.ClientSession(timeout=timeout) as session:
        return list(await asyncio.gather(*(_ask(session, config, genesis) for config in configs)))


async def _ask(session: aiohttp.ClientSession, config: NodeConfig, genesis: Genesis) -> Answer:
    before_ms = time.time() * 1000
    status = await fetch_status(session, config)
    middle_ms = (before_ms + time.time() * 1000) / 2
    if status is not None and (status.get("name"), status.get("chain_id")) != (config.name, genesis.chain_id.hex()):
        status = None
    running = status is not None or _is_locked(config.data_dir)
    ports = () if running else tuple(port for host, port in _places(config) if _is_taken(host, port))
    offset_ms = 0 if status is None else round(status.get("now_ms", middle_ms) - middle_ms)
    return Answer(config.name, running, status, offset_ms, ports)


def _is_locked(data_dir: Path) -> bool:
    if not (data_dir / LOCK_FILE_NAME).exists():
        return False
    try:
        DirectoryLock(data_dir).release()
    except BlockRobotError as error:
        return error.code == "DATA_DIRECTORY_IN_USE"
    return False


def _places(config: NodeConfig) -> tuple[tuple[str, int], ...]:
    own = (config.host, config.p2p_port), (config.api_host, config.api_port), (OPERATOR_HOST, config.operator_port)
    return (*own, (config.metrics_host, config.metrics_port)) if config.metrics_host else own


def _is_taken(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), timeout=ASK_TIMEOUT_S):
            return True
    except OSError:
        return False


def _check_answers(
    answers: Sequence[Answer], ledgers: dict[str, LedgerFacts], removed: frozenset[str]
) -> list[Finding]:
    """The ledger of a `removed` node ends: that is no late block."""
    told = [item for name, item in ledgers.items() if name not in removed]
    facts = max(told, key=lambda item: item.height, default=None)
    roots = {name: dict(item.roots) for name, item in ledgers.items() if not item.trouble}
    for answer in answers:
        if answer.status is not None and answer.status.get("state_height") is not None:
            known = roots.setdefault(answer.name, {})
            known[int(answer.status["state_height"])] = str(answer.status["state_root"])
    drift_ms = DRIFT_DEFAULT_MS if facts is None else facts.max_clock_drift_ms or DRIFT_DEFAULT_MS
    clocks = words.check_clocks(answers, drift_ms)
    found = [
        *words.check_words(answers),
        *clocks,
        *words.check_versions(answers, version("blockrobot")),
        *words.check_roots(roots),
    ]
    up_s = max((float(item.status.get("uptime_s", 0)) for item in answers if item.status is not None), default=0.0)
    late = words.check_late([answer for answer in answers if answer.name not in removed])
    found += late
    if not late and not clocks and facts is not None and facts.height > 0:
        found += words.check_finality(facts.timestamp_ms, now_ms(), facts.heartbeat_ms, facts.production, up_s)
    return found
