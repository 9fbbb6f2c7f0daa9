"""The chain's contracts: versions, interfaces, sources."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import describe
from contracts.lifecycle.describing import NamedVersion, list_contracts, list_due, read_version, read_version_source
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
    contracts = [describe(ContractSummary, row) for row in rows]
    return json_answer(ContractsAnswer(height, contracts, due=[describe(ContractChange, change) for change in due]))


def _version_answer(height: int, row: NamedVersion, source: str) -> ContractVersionAnswer:
    abi = [
        describe(ContractEntry, entry, parameters=[ContractParameter(name, of) for name, of in entry.params])
        for entry in row.entries
    ]
    return describe(ContractVersionAnswer, row, height=height, abi=abi, source=source)


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
