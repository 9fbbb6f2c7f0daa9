"""`blockrobot custody hunt`: is anything left of a record?"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import (
    EXISTING_FILE,
    EXIT_FAILED,
    FILE,
    command_output,
    console,
    print_answer,
    status_line,
)
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import folder_option, network_folder
from network.cli.custody.custody_answers import CustodyHuntAnswer, FoundRemains
from network.cli.custody.record_id import RECORD_ID
from network.cluster import Cluster
from network.custody.hunt import HuntReport, gather
from network.custody.hunt import hunt as search
from network.custody.traces import Trace, read_traces, trace_plaintext, write_traces

_SHOWN_CHARS = 60


@click.command()
@click.argument("records", metavar="RECORD...", nargs=-1, required=True, type=RECORD_ID)
@click.option(
    "--trace",
    "trace_file",
    type=FILE,
    help="What to look for: written at the first use, before an erasure; read at the next, after it.",
)
@click.option(
    "--plaintext",
    "pictures",
    multiple=True,
    type=EXISTING_FILE,
    help="A picture of the record, of which nothing may be found anywhere. With one RECORD only.",
)
@click.option(
    "--also",
    multiple=True,
    type=click.Path(path_type=Path, exists=True),
    help="Search this folder or file too: a robot's, a wallet's, a backup, a database server's files.",
)
@folder_option
@command_output
def hunt(
    records: tuple[bytes, ...],
    trace_file: Path | None,
    pictures: tuple[Path, ...],
    also: tuple[Path, ...],
    folder: Path | None,
    as_json: bool,
) -> None:
    """Search every file and database of a local network for anything of these records, and say what may be there.

    Before an erasure it shows where a record lies. After it nobody knows its ciphertexts and keys any more: have them
    noted before, as pieces that open nothing, with --trace FILE, and name the same FILE after. Exits 0 if nothing is
    found that must not be there, 1 otherwise, also if nothing was known of an erased record to look for.

    Example: blockrobot custody hunt 6f1f... --trace before.json
    """
    if pictures and len(records) != 1:
        raise click.UsageError("--plaintext is for one RECORD.")
    cluster = Cluster(network_folder(folder))
    is_known = trace_file is not None and trace_file.exists()
    known = read_traces(trace_file) if trace_file is not None and is_known else []
    lacking = {trace.record_id for trace in known} ^ set(records) if is_known else set()
    if lacking:
        raise BlockRobotError(
            "FILE_UNUSABLE", f"{trace_file} is of other records; name exactly those that it was made for."
        )
    traces = gather(cluster, list(dict.fromkeys(records)), known)
    if trace_file is not None and not is_known:
        _require_kept(traces, trace_file)
    for picture in pictures:
        trace_plaintext(traces[0], picture)
    if trace_file is not None and not is_known:
        write_traces(trace_file, traces)
    with status_line("Searching ...", as_json=as_json) as show:
        report = search(cluster, traces, also, lambda text: show(f"Searching {text[-_SHOWN_CHARS:]}"))
    if as_json:
        print_answer(_hunt_answer(report), ok=report.is_clean)
    else:
        _print(report)
    if not report.is_clean:
        sys.exit(EXIT_FAILED)


def _require_kept(traces: list[Trace], trace_file: Path) -> None:
    """Raises FILE_UNUSABLE if nothing remains to trace."""
    gone = ", ".join(trace.record_id.hex() for trace in traces if not trace.is_compared)
    if gone:
        raise BlockRobotError(
            "FILE_UNUSABLE",
            f"{trace_file} does not exist, and it is too late to begin it: {gone} is erased. Nothing was searched; name "
            "the file of --trace that was written before the erasure.",
        )


def _hunt_answer(report: HuntReport) -> CustodyHuntAnswer:
    return CustodyHuntAnswer(
        records={trace.record_id.hex(): trace.status for trace in report.traces},
        found=[
            FoundRemains(
                record=finding.record_id.hex(),
                place=finding.place,
                what=finding.what,
                count=finding.count,
                allowed=bool(finding.why),
                why=finding.why,
            )
            for finding in report.findings
        ],
        not_compared=[trace.record_id.hex() for trace in report.not_compared],
        searched_for=dict(report.searched_for),
        files_count=report.files_count,
        documents_count=report.documents_count,
        size_bytes=report.size_bytes,
        unread=report.unread,
    )


def _print(report: HuntReport) -> None:
    kinds = ", ".join(f"{count} of {kind}" for kind, count in sorted(report.searched_for.items()))
    for trace in report.traces:
        console.print(f"Record {trace.record_id.hex()}: {trace.status} on the chain.")
    searched = f"{report.files_count} files, {report.documents_count} documents, {report.size_bytes / 1e6:.0f} MB"
    console.print(f"Searched {searched} for pieces: {kinds}.")
    places: dict[tuple[str, str, str], int] = {}
    for finding in report.findings:
        key = (finding.place, finding.what, finding.why)
        places[key] = places.get(key, 0) + finding.count
    for (place, what, why), count in places.items():
        reason = why or "MUST NOT BE THERE"
        console.print(escape(f"  {what} in {place} ({count}): {reason}."))
    for place in report.unread:
        console.print(escape(f"  Not searched: {place}"))
    if report.forbidden:
        console.print(
            "Something is left that must not be. Next step: blockrobot custody scrub, then custody rebuild NODE."
        )
    elif report.is_clean:
        console.print("Nothing was found that must not be there.")
    for trace in report.not_compared:
        console.print(
            f"Record {trace.record_id.hex()} could not be compared with anything: the ciphertexts and keys of an erased "
            "record are not known any more. Next step: name the file that was written before the erasure, with --trace "
            "FILE. If there is none: blockrobot custody scrub."
        )
