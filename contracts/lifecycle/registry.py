"""Contracts shipped with BlockRobot: sources, hashes and compiled forms."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any

from consensus.chain.genesis import ContractEntry, Genesis
from consensus.errors import BlockRobotError
from contracts.vm import LANGUAGE_VERSION, CompiledContract
from contracts.vm.compiler.compile_cache import compile_once, describe_source
from contracts.vm.compiler.compile_cache import compute_source_hash as hash_source

PRIVACY_CONTRACTS = (
    "access",
    "audit",
    "consent",
    "erasure",
    "identity",
    "mandates",
    "officers",
    "records",
    "rights",
)
SYSTEM_CONTRACTS = ("forms", "lifecycle", "membership", "producers", "settings")
SHIPPED_CONTRACTS = PRIVACY_CONTRACTS + SYSTEM_CONTRACTS


def read_source(name: str) -> str:
    """Raises TRANSACTION_CONTRACT_UNKNOWN."""
    if name not in SHIPPED_CONTRACTS:
        raise BlockRobotError("TRANSACTION_CONTRACT_UNKNOWN", f"No contract {name!r} ships with BlockRobot.")
    folder = "privacy" if name in PRIVACY_CONTRACTS else "system"
    text = resources.files("contracts").joinpath(folder, f"{name}.py").read_text(encoding="utf-8")
    return text.replace("\r\n", "\n")


def compute_source_hash(source: str) -> bytes:
    """Return the 32-byte hash by which genesis names a source."""
    return hash_source(source.encode())


@cache
def _shipped_sources() -> Mapping[bytes, str]:
    return {compute_source_hash(source): source for source in map(read_source, SHIPPED_CONTRACTS)}


def find_shipped_source(source_hash: bytes) -> str | None:
    return _shipped_sources().get(source_hash)


def describe_shipped() -> list[list[Any]]:
    contracts = load_contracts()
    return [[name, describe_source(read_source(name).encode(), contracts[name])] for name in SHIPPED_CONTRACTS]


@cache
def load_contracts() -> Mapping[str, CompiledContract]:
    """Compiled once per process."""
    return MappingProxyType({name: compile_once(read_source(name), name) for name in SHIPPED_CONTRACTS})


def contract_entries() -> tuple[ContractEntry, ...]:
    return tuple(
        ContractEntry(name=name, source_hash=compute_source_hash(read_source(name))) for name in SHIPPED_CONTRACTS
    )


def check_contracts(genesis: Genesis) -> None:
    """Raises GENESIS_INVALID if sources or contract language version differ; compiles nothing."""
    if genesis.contract_language != LANGUAGE_VERSION:
        raise BlockRobotError(
            "GENESIS_INVALID",
            f"The genesis file is for version {genesis.contract_language} of the contract language, "
            f"and this version of BlockRobot speaks version {LANGUAGE_VERSION}.",
        )
    _shipped_sources()  # a worker may not open files later
    if genesis.contracts != contract_entries():
        raise BlockRobotError(
            "GENESIS_INVALID", "The genesis file names contracts that this version of BlockRobot does not ship."
        )


def require_contracts(genesis: Genesis) -> Mapping[str, CompiledContract]:
    """All loaded. Raises as `check_contracts`."""
    check_contracts(genesis)
    return load_contracts()
