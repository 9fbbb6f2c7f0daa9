"""The root command; imports lazily, so wallets never load node code."""

from __future__ import annotations

import click

from clients.sdk.terminal.lazy_group import LazyCommand
from clients.sdk.terminal.node_option import node_option
from network.cli.root_group import RootGroup

_COMMANDS = {
    "up": LazyCommand(
        "network.cli.cluster.cluster_commands:up",
        "Start the local network, making it first if there is none. Its state survives down and up.",
    ),
    "down": LazyCommand(
        "network.cli.cluster.cluster_commands:down",
        "Stop the local network, or only the nodes that are named. Nothing final is lost.",
    ),
    "status": LazyCommand(
        "network.cli.cluster.cluster_commands:status",
        "Show each node's height, finalized height, round, peers and custody checkpoint.",
    ),
    "logs": LazyCommand("network.cli.cluster.cluster_commands:logs", "Show the last log lines of one node, or of all."),
    "console": LazyCommand(
        "network.cli.cluster.console_commands:console",
        "Show a local network in the browser: who leads and votes, what flows, buttons for every fault, a time line.",
    ),
    "node": LazyCommand(
        "network.cli.node.node_commands:node",
        "Work on one node: NODE is its data directory, or its name in the local network (see --dir).",
    ),
    "fault": LazyCommand(
        "network.cli.cluster.fault_commands:fault",
        "Break the local network on purpose, and mend it; `blockrobot status --watch` shows what happens.",
    ),
    "demo": LazyCommand(
        "network.cli.measure.demo_commands:demo",
        "Run the whole story: four nodes, a robot, two patients, a visitor; check every step.",
    ),
    "genesis": LazyCommand(
        "network.cli.governance.genesis_commands:genesis",
        "Found a network of several parties: make the genesis file of everybody's entries, check it, and begin with it.",
    ),
    "org": LazyCommand("network.cli.governance.org_commands:org", "The organisations of the network and their nodes."),
    "producer": LazyCommand(
        "network.cli.governance.producer_commands:producer",
        "The producers of blocks: seats, votes, readiness, suspensions with their evidence.",
    ),
    "settings": LazyCommand(
        "network.cli.governance.settings_commands:settings",
        "The chain's settings: what is in force, and what organisations propose.",
    ),
    "frames": LazyCommand(
        "network.cli.governance.frames_commands:frames",
        "The empty frames of a robot: pictures that show nobody, on which everybody's own are shown.",
    ),
    "notice": LazyCommand(
        "network.cli.governance.notice_commands:notice",
        "What people are told before anything is recorded of them (GDPR, Articles 13 and 14), and the register of Article "
        "30.",
    ),
    "contract": LazyCommand(
        "network.cli.contract.contract_commands:contract",
        "Contracts: write, check, test and trace them; put them on a chain; call them, ask them, follow their events.",
    ),
    "certificate": LazyCommand(
        "network.cli.node.certificate_commands:certificate",
        "The certificates of nodes: list, issue, renew, revoke. NODE is a name in the network or a data directory.",
    ),
    "doctor": LazyCommand(
        "network.cli.cluster.doctor_commands:doctor",
        "Find what is wrong: nodes, clocks, certificates, disks, ports, ledgers, differing states. Exit code 1 if anything is.",  # noqa: E501
    ),
    "explore": LazyCommand(
        "network.cli.cluster.explore_commands:explore",
        "Open a node's explorer in the browser, in your own session: blocks, votes, transactions, contracts, receipts.",
    ),
    "bench": LazyCommand(
        "network.cli.measure.bench_commands:bench", "Measure the network; exits 0 only if nothing failed."
    ),
    "custody": LazyCommand(
        "network.cli.custody.custody_commands:custody",
        "See what custodians keep, prove what they erased, and mend what they lost.",
    ),
    "experiment": LazyCommand(
        "network.cli.measure.experiment_commands:experiment",
        "Run the paper's experiments and one of ours, and make the same tables from anybody's event log.",
    ),
    "privacy": LazyCommand(
        "network.cli.measure.privacy_commands:privacy", "Attack our own ledger, and see what it gives away."
    ),
    "sim": LazyCommand(
        "network.cli.measure.sim_commands:sim",
        "Play networks of production nodes on a virtual clock, network and disk.",
    ),
    "lab": LazyCommand(
        "network.cli.measure.lab_commands:lab",
        "Play stories of a network on hosts of its own, and a hospital's year in a day.",
    ),
    "card": LazyCommand("clients.registrar.cli:card", "Issue enrolment cards (registrars)."),
    "roster": LazyCommand("clients.registrar.cli:roster", "Make robots' rosters (registrars)."),
    "wallet": LazyCommand(
        "clients.wallet.cli.main:wallet", "See, check, follow and erase what robots recorded of you."
    ),
    "officer": LazyCommand(
        "clients.officer.breach_commands:officer",
        "Handle visits that were denied, lost keys and mandates (data protection officers, with a wallet of their own).",
    ),
    "verify": LazyCommand(
        "clients.bundle.cli:verify",
        "Check an export bundle offline: what is proved, against which network, up to which block, and what is not.",
    ),
    "robot": LazyCommand("clients.robot.cli.main:robot", "Record people who carry a tag, each for themselves alone."),
    "completion": LazyCommand(
        "network.cli.tool_commands:completion",
        "Print the completion script of a shell: commands, options, profiles, records that were viewed here.",
    ),
    "reference": LazyCommand(
        "network.cli.tool_commands:reference",
        "Write http-api.md, errors.md, authorisation.md, state.md and json-output.md, made from the tables in the code.",
    ),
}
SECTIONS = {
    "Patients, and whom they share with": ("wallet", "verify"),
    "Robot operators": ("robot",),
    "Registrars": ("card", "roster"),
    "Data protection officers": ("officer",),
    "Administrators of an organisation": ("genesis", "org", "producer", "settings", "notice", "frames"),
    "Operators of nodes": ("up", "down", "status", "logs", "node", "certificate", "custody", "doctor"),
    "To watch and to break a network": ("console", "explore", "fault", "demo", "lab"),
    "Contract developers": ("contract",),
    "Researchers": ("experiment", "bench", "privacy", "sim"),
    "Everybody": ("completion",),
    "Developers of BlockRobot": ("reference",),
}


@click.group(
    cls=RootGroup, places=_COMMANDS, sections=SECTIONS, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(package_name="blockrobot")
@node_option
def main() -> None:
    """BlockRobot: a permissioned ledger that gives patients control of what a social robot records of them."""


if __name__ == "__main__":
    main()
