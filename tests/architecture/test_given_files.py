"""What others wrote is parsed within bounds by one module, and files that a user names are read and written by one."""

from __future__ import annotations

import re

from tests.architecture.test_tidy import ROOT, matches, modules, place

BOUNDED_TEXT = ROOT / "consensus" / "bounded_text.py"
PARSES = re.compile(r"\bjson\.loads?\b|\btomllib\.|\bmsgspec\.(?:json\.(?:decode|Decoder)|toml|yaml)\b|\byaml\.\w*load")
PARSES_BESIDE = {
    "clients/wallet/text_catalogue.py": "the wallet's own catalogue, which every start reads",
    "clients/robot/sources/messages/field_map.py": "a field of bounded length; half characters are refused as well",
}


def test_texts_of_others_are_parsed_and_files_of_users_written_by_one_module_each() -> None:
    """Elsewhere a text of brackets would end a command with a traceback."""
    others = [path for path in modules() if path != BOUNDED_TEXT]
    assert {found.split(":")[0] for found in matches(others, PARSES)} == set(PARSES_BESIDE)
    # Elsewhere one would be open to others, follow a link, or take the place of a file unasked.
    others = [path for path in modules() if path != NEW_FILES and path.parts[len(ROOT.parts)] in {"clients", "network"}]
    assert {found.split(":")[0] for found in matches(others, WRITES)} == set(WRITES_BESIDE)


def test_files_of_users_are_read_up_to_a_limit() -> None:
    """Elsewhere a sparse file of some gigabytes would end a command with a traceback, or the machine's memory."""
    others = [path for path in modules() if path != NEW_FILES and place(path).startswith(GIVEN_FILES)]
    others = [path for path in others if not place(path).startswith(PLAYED)]
    assert {found.split(":")[0] for found in matches(others, READS_WHOLE)} == set(READS_WHOLE_BESIDE)


def test_whole_folders_are_deleted_only_where_nothing_of_a_users_lies() -> None:
    """A name that a user may have given to a folder of their own is no reason to delete it."""
    assert {found.split(":")[0] for found in matches(modules(), DELETES)} == set(DELETES_BESIDE)


DELETES = re.compile(r"\b(?:rmtree|remove_marked|removed_after)\b")
DELETES_BESIDE = {
    # what callers name, which are below
    "network/bench/clips_apart.py": "removed_after",
    "network/provisioning/network_files.py": "remove_marked",
    # what the same call made, under a name that nobody else has
    "network/bench/custody/custody_bench.py": "mkdtemp",
    "network/bench/fresh_network.py": "mkdtemp",
    "network/bench/robot/robot_bench.py": "mkdtemp",
    "network/bench/growth/growth_bench.py": "half a filled size in the cache, named by its axis and size",
    "network/bench/catch_up.py": "a ledger of a network that the bench made",
    "network/lab/hosts/loss_stories.py": "the data directory of a node on a host that the story made",
    "network/lab/year/end_checks.py": "copies of a node, in a folder that is reserved by its mark",
    "network/provisioning/network_layout.py": "mkdtemp",
    # what holds nothing but files of the program's own
    "network/provisioning/network_removal.py": "a half-made network, by its mark, without a foreign file",
    "network/provisioning/node_backup.py": "half a backup or a half restored node, by its lock, in a folder named for that",
    "network/run_folder.py": "a folder that is reserved by its mark, without a foreign file",
    # folders that a program keeps for itself
    "clients/robot/synthetic/scenario_bag.py": "half a recording in the cache, named by a hash",
    "node/snapshot/fetching.py": "snapshots.fetched in a data directory: what was erased since may stand in it",
    "node/snapshot/snapshot_store.py": "snapshots in a data directory: what was erased since may stand in it",
    "node/snapshot/restoring.py": "ledger.incoming and ledger.replaced in a data directory",
}


NEW_FILES = ROOT / "clients" / "sdk" / "new_files.py"
GIVEN_FILES = ("clients/", "contracts/kit/", "network/")
PLAYED = ("network/bench/", "network/demo/", "network/lab/")
"""These read what they wrote."""
READS_WHOLE = re.compile(
    r"^(?!.*resources\.files\().*(?:\.read_text\(|\.read_bytes\(\)|(?<!await response)(?<!self)\.read\(\)|\bclick\.File\b)"
)
READS_WHOLE_BESIDE = {
    # what a robot, a registrar, a wallet or a network holds in a folder of its own
    "clients/registrar/registrar.py": "a registrar's key and list of cards",
    "clients/robot/backgrounds/background_banks.py": "a robot's empty frames",
    "clients/robot/identity/robot_keys.py": "a robot's keys",
    "clients/robot/identity/sealed_file.py": "a robot's spool",
    "clients/robot/recording/event_log.py": "a robot's log, which may be long",
    "clients/robot/synthetic/scenario_bag.py": "the mark of a recording that was made here",
    "clients/sdk/trust_pin.py": "what a client has seen of a chain",
    "network/cluster.py": "a local network's files, and what the system says of its processes",
    "network/console/live.py": "a local network's genesis file, and pages of ours",
    "network/custody/custody_requests.py": "a node's token",
    "network/faults/control.py": "a node's token",
    "network/notices/notice_publishing.py": "a local network's genesis file and key",
    "network/provisioning/certificate_authority.py": "a network's certificate authority",
    "network/provisioning/node_certificates.py": "a node's certificate and key",
    # what a command wrote itself
    "network/cli/contract/contract_author_commands.py": "a report, in a folder that is new",
    "network/cli/contract/contract_events_commands.py": "the events that it wrote so far, which may be many",
    "network/experiments/guard.py": "what the system says of a process",
    "network/experiments/pages/experiment_page.py": "a picture of an experiment",
    "network/experiments/run_all.py": "a picture of an experiment",
    # what is installed with us
    "clients/robot/synthetic/driving/drive_file.py": "a scene",
    "clients/robot/synthetic/scenario.py": "a scenario",
    "clients/wallet/presentation/guardian_sheets.py": "styles",
    "clients/wallet/text_catalogue.py": "what the wallet says",
    "network/cli/tool_commands.py": "reference pages",
    "network/report_page.py": "styles",
    # within limits that others keep
    "clients/robot/sources/recordings/salvage.py": "a record of bounded length",
    "clients/sdk/terminal/qr_reading.py": "from the process that started it, which bounds it",
}
WRITES = re.compile(r"\.write_bytes\(|(?<!formatter)\.write_text\(|\bopen\((?:.*, )?[\"'][wax]|\bO_CREAT\b")
WRITES_BESIDE = {
    # below a folder that is made for it with mode 0700, or that a node, a robot or a wallet holds
    "clients/robot/identity/robot_keys.py": "a robot's keys, O_EXCL",
    "clients/robot/run/runner.py": "a lock",
    "clients/wallet/store/wallet_lock.py": "a lock",
    "network/cluster.py": "a local network's state and its nodes' output",
    "network/provisioning/certificate_authority.py": "keys of a network, O_EXCL",
    "network/provisioning/new_node.py": "a node's entry, in a folder that is new",
    "network/provisioning/new_organisation.py": "an organisation's public files, in a folder that is new",
    "network/provisioning/network_removal.py": "the mark of a removal, O_EXCL",
    "network/lab/privacy/hospital/household.py": "a hospital that is played",
    "network/bench/nginx.py": "a proxy that a measurement or a story starts, and a node of theirs",
    "network/lab/hosts/founded_network.py": "hosts that are made for a story",
    "network/lab/hosts/node_stories.py": "hosts that are made for a story",
    "network/lab/hosts/patient_story.py": "hosts that are made for a story",
    # files of the user's, made with O_EXCL and mode 0600
    "clients/wallet/presentation/guardian_sheets.py": "all sheets of a set or none",
    "clients/wallet/cli/mnemonic_handover.py": "words, where a file that holds the same ones will do",
    # folders of figures, pages and sources, where nothing of anybody is
    "clients/robot/recording/event_log.py": "tables of a log that an experiment wrote",
    "clients/robot/recording/waiting_samples.py": "into memory",
    "network/demo/report.py": "a demo's folder",
    "network/experiments/comparison.py": "an experiment's folder, held by its mark",
    "network/experiments/pages/process_map.py": "an experiment's folder",
    "network/experiments/pages/tables.py": "an experiment's folder",
    "network/lab/hiding/companion_training.py": "a developer's model file",
    "network/lab/hiding/moving/body_training.py": "a developer's model files",
    "network/lab/pedestrians/evaluate.py": "a developer's cache of a film",
    "network/cli/tool_commands.py": "our own reference pages, written again",
}
