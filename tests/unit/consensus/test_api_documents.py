"""Documents of the HTTP interface: a request is read strictly, an answer by clients of an older version too."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from clients.sdk.node_answers import read_answer, read_finality, read_problem
from consensus import api_documents
from consensus.api_documents import (
    ChallengeRequest,
    Document,
    Finality,
    HeadersAnswer,
    ProofsRequest,
    QueryRequest,
    ReceiptDocument,
    Request,
    SessionAnswer,
    SessionRequest,
    describe,
)
from consensus.chain.block import Receipt
from consensus.errors import BlockRobotError

KEY, WORD, SIGNATURE = "02" * 33, "ab" * 32, "cd" * 65
SESSION = {"public_key": KEY, "challenge": WORD, "signature": SIGNATURE}


def test_requests_alone_are_read_strictly_and_answers_of_later_versions_too() -> None:
    kinds = [kind for kind in vars(api_documents).values() if isinstance(kind, type) and issubclass(kind, Document)]
    strict = {kind.__name__ for kind in kinds if kind.__struct_config__.forbid_unknown_fields}
    assert strict == {kind.__name__ for kind in kinds if kind.__name__.endswith("Request")}
    fields = {"token": WORD, "kind": "member", "expires_at_ms": 7}
    assert read_answer(msgspec.json.encode(fields | {"more": 1}), SessionAnswer) == SessionAnswer(WORD, "member", 7)


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        (ChallengeRequest, {"public_key": KEY}),
        (SessionRequest, SESSION),
        (SessionRequest, SESSION | {"grant": WORD}),
        (ProofsRequest, {"keys": [KEY]}),
        (QueryRequest, {"contract": "identity", "view": "role", "args": "90"}),
    ],
)
def test_a_request_is_written_as_it_is_read_and_with_another_field_it_is_rejected(
    kind: type[Request], fields: dict[str, Any]
) -> None:
    content = msgspec.json.encode(fields)
    assert msgspec.json.encode(msgspec.json.decode(content, type=kind)) == content
    with pytest.raises(msgspec.ValidationError, match="unknown field"):
        msgspec.json.decode(msgspec.json.encode(fields | {"more": 1}), type=kind)


@pytest.mark.parametrize("args", ["9", "9g", "AB", " 90"])
def test_arguments_that_are_no_hexadecimal_are_rejected(args: str) -> None:
    content = msgspec.json.encode({"contract": "identity", "view": "role", "args": args})
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(content, type=QueryRequest)


@pytest.mark.parametrize("fields", [{}, {"token": "ab"}, {"token": "zz" * 32}, {"expires_at_ms": "7"}])
def test_a_damaged_answer_is_internal(fields: dict[str, Any]) -> None:
    whole = {"kind": "member", "expires_at_ms": 7} | fields
    with pytest.raises(BlockRobotError, match=r"^INTERNAL:"):
        read_answer(msgspec.json.encode(whole), SessionAnswer)


def test_bytes_of_an_answer_that_are_no_hexadecimal_are_internal() -> None:
    with pytest.raises(BlockRobotError, match=r"^INTERNAL:"):
        read_finality(Finality(header="0", child_header="", child_qc="", through=[]))


def test_the_schema_of_bytes_says_that_they_are_hexadecimal() -> None:
    assert msgspec.json.schema_components([Finality])[1]["Finality"]["properties"]["header"] == {
        "type": "string",
        "description": "bytes in lower-case hexadecimal",
        "pattern": "^([0-9a-f]{2})*$",
    }


def test_a_row_is_described_by_its_fields_of_the_same_names() -> None:
    receipt = Receipt(b"\x01" * 32, ok=True, code="OK", message="", line=None, gas_used=7, events=())
    assert describe(ReceiptDocument, receipt, gas_used=8) == ReceiptDocument(True, "OK", "", None, 8)


def test_bytes_in_what_is_described_are_hexadecimal_wherever_they_stand() -> None:
    row = SimpleNamespace(from_height=7, headers=(b"\x01", b"\x02"))
    assert describe(HeadersAnswer, row) == HeadersAnswer(7, ["01", "02"])
    assert describe(HeadersAnswer, row, headers=[b"\x03"]) == HeadersAnswer(7, ["03"])


@pytest.mark.parametrize(
    ("fields", "code", "detail"),
    [
        ({"code": "NOT_FOUND", "title": "Not here."}, "NOT_FOUND", "Not here."),
        ({"code": "NOT_FOUND", "detail": "No such block."}, "NOT_FOUND", "No such block."),
        ({"title": "Bad Gateway", "status": 502}, "INTERNAL", "Bad Gateway"),
        ({"code": "BRAND_NEW", "title": "Of tomorrow."}, "INTERNAL", "BRAND_NEW: Of tomorrow."),
        ({"error": "x"}, "INTERNAL", "The node answered with status 502 and no problem document."),
    ],
)
def test_a_problem_document_of_a_proxy_or_an_older_node_is_read_as_far_as_it_goes(
    fields: dict[str, Any], code: str, detail: str
) -> None:
    error = read_problem(msgspec.json.encode(fields), 502)
    assert (error.code, error.detail) == (code, detail)
