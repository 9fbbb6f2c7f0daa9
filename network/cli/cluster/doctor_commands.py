"""`blockrobot doctor`: diagnoses network or node and suggests remedies."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXIT_FAILED, FOLDER, command_output, console, print_answer, show_progress
from network.cli.cluster.cluster_answers import DoctorAnswer, DoctorFinding
from network.cli.cluster.cluster_options import folder_option, network_folder
from network.cli.governance.governance_signer import plain_table
from network.doctor.examination import Examination, examine_network, examine_node
from network.doctor.findings import Finding


@click.command()
@click.option("--data-dir", type=FOLDER, help="Look at this one node, not at a network.")
@folder_option
@command_output
def doctor(data_dir: Path | None, folder: Path | None, as_json: bool) -> None:
    """Find what is wrong: nodes, clocks, certificates, disks, ports, ledgers, differing states. Exit code 1 if anything is.

    Example: blockrobot doctor --json
    """
    if data_dir is not None:
        examination = examine_node(data_dir)
    else:
        examination = examine_network(network_folder(folder), show_progress(quiet=as_json))
    if as_json:
        answer = DoctorAnswer(
            nodes=list(examination.nodes),
            elsewhere=list(examination.elsewhere),
            findings=[_finding_answer(finding) for finding in examination.findings],
            blocks_kept=list(examination.blocks_kept),
        )
        print_answer(answer, ok=examination.ok)
    else:
        _print(examination)
    if not examination.ok:
        sys.exit(EXIT_FAILED)


def _finding_answer(finding: Finding) -> DoctorFinding:
    return DoctorFinding(
        code=finding.code,
        severity=finding.kind.severity,
        node=finding.node,
        detail=finding.detail,
        next_step=finding.next_step,
    )


def _print(examination: Examination) -> None:
    looked_at = ", ".join(examination.nodes)
    if examination.elsewhere:
        asked = f"what {', '.join(node.name for node in examination.elsewhere)} say to everybody"
        looked_at = f"{looked_at}, and {asked}" if looked_at else asked
    for line in examination.blocks_kept:
        console.print(escape(line), soft_wrap=True)
    if not examination.findings:
        console.print(f"Nothing is wrong with {escape(looked_at)}.")
        return
    table = plain_table(f"Looked at {escape(looked_at)}", ["", "node", "finding", "what was seen"])
    for finding in examination.findings:
        mark = "[red]problem[/red]" if finding.kind.severity == "problem" else "[yellow]warning[/yellow]"
        table.add_row(mark, escape(finding.node or "-"), finding.code, escape(finding.detail))
    console.print(table)
    console.print("What to do:")
    printed = set()
    for finding in examination.findings:
        step = f"  {finding.code}{f' ({finding.node})' if finding.node else ''}: {finding.next_step}"
        if step not in printed:
            printed.add(step)
            console.print(escape(step))
