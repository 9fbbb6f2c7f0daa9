"""The chain's contracts: versions, interfaces, sources."""

from __future__ import annotations

from aiohttp import web

from contracts.lifecycle.describing import VersionRow, list_contracts, list_due, read_version, read_version_source
from node.api.access.route_access import MEMBER
from node.api.contract_documents import (
    ContractChange,
    ContractEntry,
    ContractParameter,
    ContractsAnswer,
    ContractSummary,
    ContractVersionAnswer,
)
from node.api.routing import JSON, Answer, Call, Parameter, Route, json_answer


async def _list_contracts(call: Call) -> web.StreamResponse:
    with call.services.ledger.snapshot() as snapshot:
        rows, due, height = list_contracts(snapshot), list_due(snapshot), snapshot.header.height
    contracts = [
        ContractSummary(
            name=row.name,
            version=row.version,
            source_hash=row.source_hash.hex(),
            enabled=row.enabled,
            since_height=row.since_height,
            versions=row.versions,
        )
        for row in rows
    ]
    changes = [
        ContractChange(
            kind=change.kind,
            name=change.name,
            version=change.version,
            from_height=change.from_height,
            from_ms=change.from_ms,
        )
        for change in due
    ]
    return json_answer(ContractsAnswer(height=height, contracts=contracts, due=changes))


def _version_answer(height: int, row: VersionRow, source: str) -> ContractVersionAnswer:
    return ContractVersionAnswer(
        height=height,
        name=row.name,
        version=row.version,
        status=row.status,
        since_height=row.since_height,
        failure=row.failure,
        source_hash=row.source_hash.hex(),
        size_bytes=row.size_bytes,
        migrates=row.migrates,
        note=row.note,
        organisation=row.organisation,
        proposal_id=row.proposal_id.hex(),
        approved_height=row.approved_height,
        abi=[
            ContractEntry(
                name=entry.name,
                kind=entry.kind,
                parameters=[ContractParameter(name=name, type=of) for name, of in entry.params],
                required=entry.required,
                returns=entry.returns,
            )
            for entry in row.abi
        ],
        source=source,
    )


async def _get_contract(call: Call) -> web.StreamResponse:
    name, version = call.http.match_info["name"], call.int_of("version")
    with call.services.ledger.snapshot() as snapshot:
        row = read_version(snapshot, name, version)
        source, height = read_version_source(snapshot, row), snapshot.header.height
    return json_answer(_version_answer(height, row, source))


ROUTES = (
    Route(
        "GET",
        "/v1/contracts",
        "listContracts",
        "The chain's contracts with their versions, and the changes that are due.",
        MEMBER,
        _list_contracts,
        Answer(JSON, ContractsAnswer, "All contracts."),
    ),
    Route(
        "GET",
        "/v1/contracts/{name}",
        "getContract",
        "A contract's version in force (or another one) with its interface and its source.",
        MEMBER,
        _get_contract,
        Answer(JSON, ContractVersionAnswer, "The version."),
        parameters=(
            Parameter("name", "path", "The contract's name.", pattern="^[a-z][a-z0-9_-]{0,31}$"),
            Parameter("version", "query", "Which version; 0 is the one in force.", maximum=1_000_000, default=0),
        ),
        errors=("CONTRACT_NOT_FOUND",),
    ),
)
