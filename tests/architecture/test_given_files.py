"""What others wrote is parsed within bounds by one module, and files that a user names are written by one module."""

from __future__ import annotations

import re

from tests.architecture.test_tidy import ROOT, matches, modules

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


NEW_FILES = ROOT / "clients" / "sdk" / "new_files.py"
WRITES = re.compile(r"\.write_bytes\(|(?<!formatter)\.write_text\(|\bopen\((?:.*, )?[\"'][wax]|\bO_CREAT\b")
WRITES_BESIDE = {
    # below a folder that is made for it with mode 0700, or that a node, a robot or a wallet holds
    "clients/robot/identity/robot_keys.py": "a robot's keys, O_EXCL",
    "clients/robot/run/runner.py": "a lock",
    "clients/wallet/store/wallet_lock.py": "a lock",
    "network/cluster.py": "a local network's state and its nodes' output",
    "network/provisioning/certificate_authority.py": "keys of a network, O_EXCL",
    "network/provisioning/network_layout.py": "a network's public files, in a folder that is new",
    "network/provisioning/network_removal.py": "the mark of a removal, O_EXCL",
    "network/provisioning/node_joining.py": "a node's entry, in a folder that is new",
    "network/lab/privacy/hospital/household.py": "a hospital that is played",
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
    "network/experiments/run_all.py": "an experiment's folder",
    "network/lab/hiding/companion_training.py": "a developer's model file",
    "network/lab/hiding/moving/body_training.py": "a developer's model files",
    "network/lab/pedestrians/evaluate.py": "a developer's cache of a film",
    "network/cli/tool_commands.py": "our own reference pages, written again",
}
