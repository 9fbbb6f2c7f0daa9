"""Checks of a data directory without its node: keys, certificate, disk, journal."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from pathlib import Path

from consensus.errors import BlockRobotError
from network.doctor.findings import Finding
from network.provisioning.certificate_requests import check_fit
from network.provisioning.new_node import hosts_of
from network.provisioning.node_certificates import read_certificate, read_report
from node.config import NodeConfig
from node.consensus.journal import count_records
from node.directory.node_directory import DirectoryContent
from node.p2p.identity import load_authorities
from pages.time_format import format_time

DISK_FREE_LEAST_BYTES = 512 * 1024 * 1024
DISK_FREE_LEAST_PER_CENT = 3
AUTHORITY_WARNING_MS = 365 * 24 * 3600 * 1000
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_CERTIFICATE_CODES = {
    "expired": "CERTIFICATE_EXPIRED",
    "expiring": "CERTIFICATE_EXPIRES_SOON",
    "revoked": "CERTIFICATE_REVOKED",
}


def check_directory(
    config: NodeConfig, directory: DirectoryContent, now_ms: int, disk_free: tuple[int, int] | None = None
) -> list[Finding]:
    """`disk_free`: (free, total) bytes, else measured."""
    return [
        *check_certificate(config, directory, now_ms),
        *check_keys(config),
        *check_disk(config, disk_free),
        *check_journal(config),
    ]


def check_certificate(config: NodeConfig, directory: DirectoryContent, now_ms: int) -> list[Finding]:
    report = read_report(config)
    state = report.state(now_ms, directory.revoked)
    if state == "unusable":
        return [Finding("CERTIFICATE_UNUSABLE", config.name, report.trouble)]
    if state == "valid" or report.facts is None:
        return _check_names(config, directory)
    verb = {"expired": "expired on", "expiring": "expires on", "revoked": "was revoked; it would count until"}[state]
    detail = f"Certificate {report.facts.serial_hex} {verb} {report.facts.expires}."
    return [Finding(_CERTIFICATE_CODES[state], config.name, detail)]


def _check_names(config: NodeConfig, directory: DirectoryContent) -> list[Finding]:
    node = directory.nodes.get(config.name)
    if node is None:
        return []
    try:
        check_fit(read_certificate(config), (node.name, *hosts_of(node)))
    except BlockRobotError as error:
        return [Finding("CERTIFICATE_UNFIT", config.name, f"{error.detail} Its place is agreed at {node.api_url}.")]
    return []


def check_authorities(directory: DirectoryContent, now_ms: int) -> list[Finding]:
    found = []
    for organisation in directory.organisations.values():
        if not organisation.is_active:
            continue
        authorities = load_authorities(organisation.ca_certificate)
        if not authorities:
            detail = f"The certificate authority of {organisation.name} on the chain cannot be read."
            found.append(Finding("AUTHORITY_UNREADABLE", "", detail))
            continue
        end_ms = max(round(item.not_valid_after_utc.timestamp() * 1000) for item in authorities)
        if end_ms - now_ms < AUTHORITY_WARNING_MS:
            detail = f"The authority of {organisation.name} counts until {format_time(end_ms)}."
            found.append(Finding("AUTHORITY_EXPIRES_SOON", "", detail))
    return found


def check_keys(config: NodeConfig) -> list[Finding]:
    keys = [config.tls_key_path, config.producer_key_path, config.custodian_key_path]
    found = [
        Finding("KEY_FILE_MISSING", config.name, f"{config.name_of(path)} is missing.")
        for path in keys
        if path is not None and not path.exists()
    ]
    secrets = [*(path for path in keys if path is not None), config.data_dir]
    for path in secrets:
        mode = _mode(path)
        if mode is not None and mode & _OTHERS:
            name = "the data directory" if path == config.data_dir else config.name_of(path)
            found.append(Finding("KEY_FILE_EXPOSED", config.name, f"{name} has mode {stat.S_IMODE(mode):o}."))
    return found


def _mode(path: Path) -> int | None:
    try:
        return path.stat().st_mode
    except OSError:
        return None


def check_disk(config: NodeConfig, disk_free: tuple[int, int] | None = None) -> list[Finding]:
    found = []
    clips = [] if config.clips_dir is None or not config.clips_dir.is_dir() else [config.clips_dir]
    disks = {disk_free or _room_at(place): place for place in (*clips, config.data_dir)}
    for (free, total), place in disks.items():
        if free < DISK_FREE_LEAST_BYTES or free * 100 < total * DISK_FREE_LEAST_PER_CENT:
            detail = f"{free // 2**20} MiB of {total // 2**20} MiB are free at {place}."
            found.append(Finding("DISK_LOW", config.name, detail))
    for folder in (config.data_dir, config.journal_dir, config.ledger_dir, *clips):
        if not folder.is_dir():
            continue
        try:
            with tempfile.TemporaryFile(dir=folder) as file:
                file.write(b"\0")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            detail = f"{folder} takes no file: {error.strerror}."
            found.append(Finding("DIRECTORY_UNWRITABLE", config.name, detail))
    return found


def _room_at(place: Path) -> tuple[int, int]:
    usage = shutil.disk_usage(place)
    return usage.free, usage.total


def check_journal(config: NodeConfig) -> list[Finding]:
    try:
        count_records(config.journal_path)
    except BlockRobotError as error:
        code = error.code if error.code in {"JOURNAL_MISSING", "JOURNAL_DAMAGED"} else "DIRECTORY_UNWRITABLE"
        return [Finding(code, config.name, error.detail)]
    return []
