"""Explorer routes; a public explorer opens only these to anybody."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import PAGE_MAX_COUNT
from consensus.contract_refusals import find_next_step
from consensus.errors import CATALOGUE, BlockRobotError
from node.api.access.metering import Steps
from node.api.access.route_access import ANYONE, EXPLORER
from node.api.chain_headers import HeaderReader, count_all, describe_epoch, describe_producers
from node.api.explorer_documents import (
    EpochDocument,
    ExplorerHeadersAnswer,
    ExplorerStatusAnswer,
    HeaderDocument,
    ProducersAnswer,
    RefusalAnswer,
)
from node.api.ports import ApiServices
from node.api.routes.transactions import WAIT_MAX_MS
from node.api.routing import BYTES, JSON, Answer, Call, Parameter, Route, json_answer
from node.explorer.page import answer_own, answer_shared
from node.storage.ledger_view import LedgerView

_BUDGET = "A budget of the call was spent"
MACHINE_MEANINGS = {
    "OK": "The call did what it was asked to do.",
    "OUT_OF_GAS": f"{_BUDGET}: it took more work than one transaction may.",
    "MEMORY_BUDGET": f"{_BUDGET}: it held too much in memory.",
    "CALL_DEPTH": f"{_BUDGET}: contracts called each other too deeply.",
    "WRITE_BUDGET": f"{_BUDGET}: it wrote too much.",
    "EVENT_BUDGET": f"{_BUDGET}: it emitted too many or too large events.",
    "TYPE_ERROR": "The contract met a value of another type than it can work with.",
    "VALUE_ERROR": "The contract met a value that an operation does not take.",
    "KEY_ERROR": "The contract looked up a key that is not there.",
    "INDEX_ERROR": "The contract looked beyond the end of a list.",
    "ZERO_DIVISION": "The contract divided by zero.",
    "INT_OVERFLOW": "A whole number grew beyond 256 bits.",
    "NAME_UNSET": "The contract read a variable that has no value yet.",
    "ENTRY_UNKNOWN": "The contract has no such entry.",
    "ARGUMENTS_INVALID": "The entry does not take these arguments.",
    "REENTRANT": "A contract was called that was already running in the same call.",
    "VIEW_WRITES": "A view would have changed the state.",
    "LIFECYCLE_ONLY": "The call needs what only the contract `lifecycle` may do.",
}


def explain_refusal(code: str) -> RefusalAnswer:
    """Catalogue first, then machine, then shipped contracts."""
    entry = CATALOGUE.get(code)
    if entry is not None:
        return RefusalAnswer(code=code, origin="catalogue", meaning=entry.meaning, next_step=entry.next_step)
    next_step = find_next_step(code, "")
    if code in MACHINE_MEANINGS:
        return RefusalAnswer(code=code, origin="machine", meaning=MACHINE_MEANINGS[code], next_step=next_step)
    meaning = "A rule of the contract refused the call; its own words say which."
    return RefusalAnswer(code=code, origin="contract", meaning=meaning, next_step=next_step)


_CODE_PATTERN = "^[A-Z][A-Z0-9_]{1,63}$"
_NAME_PATTERN = "^[A-Za-z][A-Za-z0-9_-]{0,63}\\.[a-z]{2,4}$"
_HTML = "text/html"


def _status(services: ApiServices, snapshot: LedgerView) -> ExplorerStatusAnswer:
    return ExplorerStatusAnswer(
        node=services.node_name,
        network=services.genesis.network,
        chain_id=services.genesis.chain_id.hex(),
        now_ms=services.clock.now_ms(),
        is_public=services.public_explorer,
        head=snapshot.header.height,
        earliest_height=snapshot.earliest_height,
        epoch=snapshot.header.epoch,
        rounds=None if services.rounds is None else services.rounds.place(),
        counts=count_all(snapshot),
    )


async def _get_status(call: Call) -> web.StreamResponse:
    services, after, wait_ms = call.services, call.int_of("after_height"), call.int_of("wait_ms")
    if wait_ms:
        with services.ledger.snapshot() as snapshot:
            is_news = snapshot.header.height > after
        if not is_news:
            with call.hold_back() as allowed:
                if allowed:
                    await services.ledger.wait_above(after, wait_ms)
    with services.ledger.snapshot() as snapshot:
        return json_answer(_status(services, snapshot))


def _reader(call: Call, snapshot: LedgerView) -> HeaderReader:
    return HeaderReader(snapshot, call.services.genesis, call.services.rounds)


def _read_headers(call: Call, snapshot: LedgerView, first: int, limit: int) -> Steps[web.Response]:
    head, earliest = snapshot.header.height, snapshot.earliest_height
    reader, headers = _reader(call, snapshot), []
    for height in range(first, min(first + limit, head + 1)):
        header = reader.read(height)
        if header is not None:
            headers.append(header)
        yield
    return json_answer(ExplorerHeadersAnswer(head=head, earliest_height=earliest, headers=headers))


async def _list_headers(call: Call) -> web.StreamResponse:
    first, limit = call.int_of("from_height"), call.int_of("limit")
    return await call.read(lambda snapshot: _read_headers(call, snapshot, first, limit))


async def _get_header(call: Call) -> web.StreamResponse:
    block_id = call.bytes_of("block_id")
    with call.services.ledger.snapshot() as snapshot:
        height = snapshot.block_height(block_id)
        header = None if height is None else _reader(call, snapshot).read(height)
    if header is None:
        raise BlockRobotError("NOT_FOUND", "No finalized block has this id.")
    return json_answer(header)


async def _get_epoch(call: Call) -> web.StreamResponse:
    genesis = call.services.genesis
    with call.services.ledger.snapshot() as snapshot:
        answer = describe_epoch(HeaderReader(snapshot, genesis), snapshot, genesis, call.int_of("number"))
    return json_answer(answer)


async def _list_producers(call: Call) -> web.StreamResponse:
    with call.services.ledger.snapshot() as snapshot:
        answer = describe_producers(snapshot)
    return json_answer(answer)


async def _explain_refusal(call: Call) -> web.StreamResponse:
    return json_answer(explain_refusal(call.http.match_info["code"]))


async def _redirect(_call: Call) -> web.StreamResponse:
    return web.Response(status=308, headers={"Location": "explorer/"})


async def _get_index(call: Call) -> web.StreamResponse:
    return answer_own("", call.http.headers)


async def _get_file(call: Call) -> web.StreamResponse:
    return answer_own(call.http.match_info["name"], call.http.headers)


async def _get_shared_file(call: Call) -> web.StreamResponse:
    return answer_shared(call.http.match_info["name"], call.http.headers)


_DATA_ROUTES = (
    Route(
        "GET",
        "/v1/explorer/status",
        "getExplorerStatus",
        "Who answers, how far it is, the round it says it is in, and counts. With `wait_ms` the answer is held back "
        "until there is a block above `after_height`, unless too many are.",
        EXPLORER,
        _get_status,
        Answer(JSON, ExplorerStatusAnswer, "The node's own word."),
        parameters=(
            Parameter("after_height", "query", "The height that the caller knows.", default=0),
            Parameter("wait_ms", "query", "How long to wait for a new block, in ms.", maximum=WAIT_MAX_MS, default=0),
        ),
    ),
    Route(
        "GET",
        "/v1/explorer/headers",
        "listExplorerHeaders",
        "Finalized headers, decoded: who led, who voted, which rounds were given up before.",
        EXPLORER,
        _list_headers,
        Answer(JSON, ExplorerHeadersAnswer, "The headers, lowest first."),
        parameters=(
            Parameter("from_height", "query", "The first height.", default=0),
            Parameter("limit", "query", "How many at most.", None, 1, PAGE_MAX_COUNT, 50),
        ),
        errors=("NOT_FOUND",),
    ),
    Route(
        "GET",
        "/v1/explorer/headers/{block_id}",
        "getExplorerHeader",
        "The finalized header with this id, decoded.",
        EXPLORER,
        _get_header,
        Answer(JSON, HeaderDocument, "The header."),
        parameters=(Parameter("block_id", "path", "The block's id.", 32),),
        errors=("NOT_FOUND",),
    ),
    Route(
        "GET",
        "/v1/explorer/epochs/{number}",
        "getExplorerEpoch",
        "Who sits in an epoch, in the order of turns.",
        EXPLORER,
        _get_epoch,
        Answer(JSON, EpochDocument, "The epoch."),
        parameters=(Parameter("number", "path", "The epoch.", maximum=(1 << 32) - 1),),
        errors=("NOT_FOUND",),
    ),
    Route(
        "GET",
        "/v1/explorer/producers",
        "listExplorerProducers",
        "Producers and candidates: votes, suspensions, evidence.",
        EXPLORER,
        _list_producers,
        Answer(JSON, ProducersAnswer, "All of them."),
    ),
    Route(
        "GET",
        "/v1/explorer/refusals/{code}",
        "explainRefusal",
        "What the code of a receipt means.",
        EXPLORER,
        _explain_refusal,
        Answer(JSON, RefusalAnswer, "The meaning."),
        parameters=(Parameter("code", "path", "The code.", pattern=_CODE_PATTERN),),
    ),
)
_PAGE_ROUTES = (
    Route(
        "GET",
        "/explorer",
        "redirectToExplorer",
        "The way to the explorer.",
        ANYONE,
        _redirect,
        Answer(_HTML, None, "There.", 308),
    ),
    Route(
        "GET",
        "/explorer/",
        "getExplorer",
        "The explorer's page. It holds no data and takes no session: it shows what the other routes tell anybody.",
        ANYONE,
        _get_index,
        Answer(_HTML, None, "The page."),
    ),
    Route(
        "GET",
        "/explorer/{name}",
        "getExplorerFile",
        "A file of the explorer: script, style, picture.",
        ANYONE,
        _get_file,
        Answer(BYTES, None, "The file, with its own type and an entity tag."),
        parameters=(Parameter("name", "path", "The file's name.", pattern=_NAME_PATTERN),),
        errors=("ROUTE_UNKNOWN",),
    ),
    Route(
        "GET",
        "/explorer/shared/{name}",
        "getSharedFile",
        "A file that all pages share.",
        ANYONE,
        _get_shared_file,
        Answer(BYTES, None, "The file, with its own type and an entity tag."),
        parameters=(Parameter("name", "path", "The file's name.", pattern=_NAME_PATTERN),),
        errors=("ROUTE_UNKNOWN",),
    ),
)
ROUTES = (*_DATA_ROUTES, *_PAGE_ROUTES)
