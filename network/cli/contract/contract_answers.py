"""What `blockrobot contract` answers with `--json`."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import UNSET, UnsetType

from clients.sdk.terminal.json_answers import (
    Answer,
    AnswerLine,
    AnswersByCommand,
    Count,
    Height,
    Hex,
    TimeMs,
    doc,
)
from network.cli.governance.governance_answers import DecisionAnswer, OpenProposal


class EntryParameter(Answer, frozen=True, kw_only=True):
    """A parameter of an entry."""

    name: Annotated[str, doc("Its name")]
    type: Annotated[str, doc("Its type")]


class ContractInterfaceEntry(Answer, frozen=True, kw_only=True):
    """An entry or view of a contract."""

    name: Annotated[str, doc("Its name")]
    kind: Annotated[str, doc("`export`, `view`, `genesis` or `migrate`")]
    parameters: Annotated[list[EntryParameter], doc("Its parameters, in order")]
    required: Annotated[Count, doc("How many of them have no default")]
    returns: Annotated[str, doc("The type of its result")]


class CheckedEntry(ContractInterfaceEntry, frozen=True, kw_only=True):
    """An entry or view in a source."""

    line: Annotated[Count, doc("The line at which it begins")]


class SourceProblem(Answer, frozen=True, kw_only=True):
    """A problem of a contract's source."""

    code: Annotated[str, doc("Its code")]
    line: Annotated[Count, doc("The line")]
    column: Annotated[Count, doc("The column")]
    message: Annotated[str, doc("What is wrong")]
    fix: Annotated[str, doc("What to write instead")]
    source: Annotated[str, doc("The text of that line")]


class CheckedSource(Answer, frozen=True, kw_only=True):
    """A source that was checked."""

    file: Annotated[str, doc("The file")]
    contract: Annotated[str, doc("The contract's name")]
    ok: Annotated[bool, doc("Whether nothing is wrong with it")]
    problems: Annotated[list[SourceProblem], doc("What is wrong")]
    entries: Annotated[list[CheckedEntry], doc("Its entries and views; none if something is wrong")]


class ContractCheckAnswer(Answer, frozen=True, kw_only=True):
    """Sources that were checked. `ok` is false if something is wrong with one."""

    language: Annotated[Count, doc("The version of the contract language")]
    files: Annotated[list[CheckedSource], doc("Each source")]


class VectorDifference(Answer, frozen=True, kw_only=True):
    """A golden vector that came out otherwise."""

    call: Annotated[str, doc("The call or source")]
    expected: Annotated[Any, doc("What the vector says")]
    found: Annotated[Any, doc("What came out")]


class VectorsFile(Answer, frozen=True, kw_only=True):
    """A file of golden vectors."""

    file: Annotated[str, doc("Its name")]
    count: Annotated[Count, doc("How many calls and sources are in it")]
    differences: Annotated[list[VectorDifference], doc("What came out otherwise")]


class ContractVectorsAnswer(Answer, frozen=True, kw_only=True):
    """Golden vectors that were played. `ok` is false if one came out otherwise."""

    language: Annotated[Count, doc("The version of the contract language")]
    count: Annotated[Count, doc("How many calls and sources there are")]
    files: Annotated[list[VectorsFile], doc("Each file")]
    written: Annotated[bool, doc("Whether they were written anew")]


class ContractNewAnswer(Answer, frozen=True, kw_only=True):
    """A contract that was begun."""

    folder: Annotated[str, doc("Its folder")]
    files: Annotated[list[str], doc("The files that were written")]


class TestedLine(Answer, frozen=True, kw_only=True):
    """A line that tests could run."""

    line: Annotated[Count, doc("Its number")]
    runs: Annotated[Count, doc("How often it ran")]
    gas: Annotated[Count, doc("The gas that it used")]


class TestedEntry(Answer, frozen=True, kw_only=True):
    """The gas of an entry in the calls that succeeded."""

    name: Annotated[str, doc("The entry")]
    calls: Annotated[Count, doc("How many calls")]
    gas_min: Annotated[Count, doc("The least gas of one")]
    gas_median: Annotated[Count, doc("The median")]
    gas_max: Annotated[Count, doc("The most")]


class TestedSource(Answer, frozen=True, kw_only=True):
    """A source that tests ran."""

    contract: Annotated[str, doc("The contract's name")]
    file: Annotated[str, doc("The file; empty if it came from none")]
    covered: Annotated[Count, doc("How many lines ran")]
    lines_count: Annotated[Count, doc("How many lines can run")]
    missing: Annotated[list[Count], doc("The lines that did not run")]
    lines: Annotated[list[TestedLine], doc("Each line that can run")]
    entries: Annotated[list[TestedEntry], doc("Each entry that was called")]


class ContractTestAnswer(Answer, frozen=True, kw_only=True):
    """Tests of contracts. `ok` is false if one fails, or there is none."""

    exit_code: Annotated[Count, doc("The exit code of pytest")]
    output: Annotated[str, doc("The output of pytest")]
    sources: Annotated[list[TestedSource], doc("Each source that ran")]


class ContractDecisionAnswer(Answer, frozen=True, kw_only=True):
    """A change of a contract that was proposed or approved."""

    height: Annotated[Height, doc("The block that holds the call")]
    txid: Annotated[Hex, doc("The call")]
    executed: Annotated[bool, doc("Whether the change is decided with it")]
    due_height: Annotated[Height | None, doc("The block with which it takes effect; null if it is not decided")]
    state: Annotated[str | None, doc("`in force`, `disabled` or `overtaken`; null if it was not waited for")]
    version: Annotated[Count | None, doc("The version that is in force then; null if it was not waited for")]
    proposal: Annotated[OpenProposal | None, doc("The proposal; null if it is not open any more")]


class ContractInForce(Answer, frozen=True, kw_only=True):
    """A contract of the chain."""

    name: Annotated[str, doc("Its name")]
    version: Annotated[Count, doc("The version in force")]
    versions: Annotated[Count, doc("How many versions there are")]
    enabled: Annotated[bool, doc("Whether it answers; false if it is disabled")]
    since_height: Annotated[Height, doc("Since which block")]
    source_hash: Annotated[Hex, doc("The hash of its source")]


class ContractChangeDue(Answer, frozen=True, kw_only=True):
    """A change of a contract that is decided and due."""

    kind: Annotated[str, doc("`activate`, `disable`, `keep` or `return`")]
    name: Annotated[str, doc("The contract")]
    version: Annotated[Count, doc("The version that is meant")]
    from_height: Annotated[Height, doc("The block with which it takes effect; 0 if it is due by time")]
    from_ms: Annotated[TimeMs, doc("When it takes effect; 0 if it is due by height")]


class FailedVersion(Answer, frozen=True, kw_only=True):
    """A version that did not take effect."""

    name: Annotated[str, doc("The contract")]
    version: Annotated[Count, doc("The version")]
    since_height: Annotated[Height, doc("The block in which it failed")]
    failure: Annotated[str, doc("Why")]


class ContractListAnswer(Answer, frozen=True, kw_only=True):
    """The contracts of the chain."""

    height: Annotated[Height, doc("The block as of which it is proved")]
    contracts: Annotated[list[ContractInForce], doc("Each contract")]
    due: Annotated[list[ContractChangeDue], doc("Changes that are due")]
    failed: Annotated[list[FailedVersion], doc("Versions that failed")]
    proposals: Annotated[list[OpenProposal], doc("Open proposals")]


class ContractShowAnswer(Answer, frozen=True, kw_only=True):
    """A version of a contract."""

    name: Annotated[str, doc("The contract")]
    height: Annotated[Height, doc("The block as of which it is proved")]
    version: Annotated[Count | UnsetType, doc("The version; absent with `--proposal`")] = UNSET
    status: Annotated[
        str | UnsetType, doc("`approved`, `active`, `superseded`, `disabled` or `failed`; absent with `--proposal`")
    ] = UNSET
    since_height: Annotated[
        Height | UnsetType, doc("Since which block it has that status; absent with `--proposal`")
    ] = UNSET
    failure: Annotated[str | UnsetType, doc("Why it failed; empty if it did not; absent with `--proposal`")] = UNSET
    size_bytes: Annotated[Count | UnsetType, doc("The size of its source; absent with `--proposal`")] = UNSET
    migrates: Annotated[bool | UnsetType, doc("Whether it has a `@migrate` entry; absent with `--proposal`")] = UNSET
    note: Annotated[str | UnsetType, doc("Why it was proposed; may be empty; absent with `--proposal`")] = UNSET
    organisation: Annotated[
        str | UnsetType, doc("Who proposed it; empty if it came with BlockRobot; absent with `--proposal`")
    ] = UNSET
    source_hash: Annotated[Hex | UnsetType, doc("The hash of its source; absent with `--proposal`")] = UNSET
    proposal_id: Annotated[Hex | UnsetType, doc("Its proposal; may be empty; absent with `--proposal`")] = UNSET
    approved_height: Annotated[
        Height | UnsetType, doc("The block in which it was decided; absent with `--proposal`")
    ] = UNSET
    due: Annotated[list[ContractChangeDue], doc("Changes of the contract that are due")]
    failed: Annotated[FailedVersion | None, doc("The contract's version that failed; null if none did")]
    proposal: Annotated[OpenProposal | None, doc("The proposal that is shown; null without `--proposal`")]
    abi: Annotated[list[ContractInterfaceEntry], doc("Its entries and views")]
    source: Annotated[str, doc("Its source")]


class InterfaceChange(Answer, frozen=True, kw_only=True):
    """A change for callers of a contract."""

    change: Annotated[str, doc("`added`, `removed`, `changed`, or `compatible` (calls of before still work)")]
    entry: Annotated[str, doc("The entry")]


class ComparedProposal(Answer, frozen=True, kw_only=True):
    """A proposal that was compared."""

    id: Annotated[Hex, doc("The proposal")]
    kind: Annotated[str, doc("What it asks for")]
    organisation: Annotated[str, doc("Who proposed it")]
    arguments: Annotated[dict[str, Any], doc("The arguments of the contract; bytes in hexadecimal")]


class ContractDiffAnswer(Answer, frozen=True, kw_only=True):
    """The difference of two versions of a contract."""

    name: Annotated[str, doc("The contract")]
    old: Annotated[str, doc("The one version")]
    new: Annotated[str, doc("The other version")]
    old_hash: Annotated[Hex, doc("The hash of the one source")]
    new_hash: Annotated[Hex, doc("The hash of the other source")]
    equal: Annotated[bool, doc("Whether they are equal")]
    abi: Annotated[list[InterfaceChange], doc("What changes for callers")]
    diff: Annotated[list[str], doc("The difference, line by line, as a unified diff")]
    proposals: Annotated[list[ComparedProposal], doc("The proposals among the two")]


class ContractQueryAnswer(Answer, frozen=True, kw_only=True):
    """What a view says; it is not proved."""

    contract: Annotated[str, doc("The contract")]
    view: Annotated[str, doc("The view")]
    result: Annotated[Any, doc("Its result; bytes in hexadecimal")]


class EmittedEvent(Answer, frozen=True, kw_only=True):
    """An event of a call."""

    contract: Annotated[str, doc("The contract that emitted it")]
    name: Annotated[str, doc("Its name")]
    data: Annotated[Any, doc("Its data; bytes in hexadecimal")]


class CallRefusal(Answer, frozen=True, kw_only=True):
    """Why a contract refused a call."""

    code: Annotated[str, doc("`CALL_REFUSED`")]
    detail: Annotated[str, doc("The contract's code and message")]
    next_step: Annotated[str, doc("What to do")]


class ContractCallAnswer(Answer, frozen=True, kw_only=True):
    """The receipt of a call. `ok` is false if the contract refused it."""

    txid: Annotated[Hex, doc("The call")]
    height: Annotated[Height, doc("The block that holds it")]
    index: Annotated[Count, doc("Its place in the block")]
    code: Annotated[str, doc("`OK`, or why it was refused")]
    message: Annotated[str, doc("The contract's message; may be empty")]
    line: Annotated[Count | None, doc("The line of the source at which it was refused; null if none is known")]
    gas_used: Annotated[Count, doc("The gas that it used")]
    events: Annotated[list[EmittedEvent], doc("Its events")]
    error: Annotated[CallRefusal | UnsetType, doc("Why it was refused; absent if it was not")] = UNSET


class TraceStep(Answer, frozen=True, kw_only=True):
    """A line that ran."""

    contract: Annotated[str, doc("The contract")]
    function: Annotated[str, doc("The function")]
    line: Annotated[Count, doc("The line's number")]
    depth: Annotated[Count, doc("The depth of the call")]
    gas: Annotated[Count, doc("The gas that it used")]
    source: Annotated[str, doc("The text of that line")]
    values: Annotated[dict[str, str], doc("The variables that it set, and their values")]


class ContractTraceAnswer(Answer, frozen=True, kw_only=True):
    """A transaction that was executed again."""

    txid: Annotated[str, doc("The transaction, as it was given")]
    height: Annotated[Height, doc("The block that holds it")]
    call: Annotated[str, doc("The entry that it calls")]
    code: Annotated[str, doc("`OK`, or why it was refused")]
    message: Annotated[str, doc("The contract's message; may be empty")]
    line: Annotated[Count | None, doc("The line at which it was refused; null if none is known")]
    gas_used: Annotated[Count, doc("The gas that it used")]
    steps: Annotated[list[TraceStep], doc("The lines that ran, in order")]
    left_out: Annotated[Count, doc("How many more ran that are left out")]


class ContractEventAnswer(AnswerLine, frozen=True, kw_only=True):
    """An event: printed one a line, without `ok`."""

    place: Annotated[str, doc("Its place: `height:index`")]
    contract: Annotated[str, doc("The contract that emitted it")]
    name: Annotated[str, doc("Its name")]
    data: Annotated[Any, doc("Its data; bytes in hexadecimal")]
    txid: Annotated[Hex, doc("Its transaction")]


ANSWERS: AnswersByCommand = {
    "contract new": ContractNewAnswer,
    "contract check": ContractCheckAnswer,
    "contract test": ContractTestAnswer,
    "contract vectors": ContractVectorsAnswer,
    "contract propose": ContractDecisionAnswer,
    "contract approve": ContractDecisionAnswer,
    "contract withdraw": DecisionAnswer,
    "contract activate": ContractDecisionAnswer,
    "contract disable": ContractDecisionAnswer,
    "contract keep": ContractDecisionAnswer,
    "contract list": ContractListAnswer,
    "contract show": ContractShowAnswer,
    "contract diff": ContractDiffAnswer,
    "contract query": ContractQueryAnswer,
    "contract call": ContractCallAnswer,
    "contract trace": ContractTraceAnswer,
    "contract events": ContractEventAnswer,
}
