"""The reference page of what commands answer with `--json`, and its JSON Schema, made from the answers' types."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping

from clients.bundle.bundle_answers import ANSWERS as BUNDLE
from clients.officer.officer_answers import ANSWERS as OFFICER
from clients.registrar.registrar_answers import ANSWERS as REGISTRAR
from clients.robot.cli.robot_answers import ANSWERS as ROBOT
from clients.sdk.terminal.json_answers import AnswersByCommand, list_kinds, write_schema
from clients.wallet.answers.consent_answers import ANSWERS as CONSENT
from clients.wallet.answers.guardian_answers import ANSWERS as GUARDIANS
from clients.wallet.answers.mandate_answers import OFFICER_ANSWERS as OFFICER_MANDATES
from clients.wallet.answers.mandate_answers import WALLET_ANSWERS as WALLET_MANDATES
from clients.wallet.answers.record_answers import ANSWERS as RECORDS
from clients.wallet.answers.rights_answers import ANSWERS as RIGHTS
from clients.wallet.answers.sharing_answers import ANSWERS as SHARING
from clients.wallet.answers.wallet_answers import ANSWERS as WALLET
from network.cli.cluster.cluster_answers import ANSWERS as NETWORK
from network.cli.cluster.status_answers import ANSWERS as STATUS
from network.cli.contract.contract_answers import ANSWERS as CONTRACTS
from network.cli.custody.custody_answers import ANSWERS as CUSTODY
from network.cli.governance.governance_answers import ANSWERS as GOVERNING
from network.cli.measure.lab_answers import ANSWERS as LAB
from network.cli.node.node_answers import ANSWERS as NODES
from network.cli.tool_answers import ANSWERS as TOOLS

PAGE = "json-output.md"
SCHEMA = "json-output.schema.json"

SECTIONS: Mapping[str, AnswersByCommand] = {
    "A network on this machine": {**STATUS, **NETWORK},
    "Checking a bundle": BUNDLE,
    "The wallet": {**WALLET, **CONSENT, **RECORDS, **RIGHTS, **SHARING, **GUARDIANS, **WALLET_MANDATES},
    "Data protection officers": {**OFFICER, **OFFICER_MANDATES},
    "The registrar": REGISTRAR,
    "The robot": ROBOT,
    "Governing and keeping a network": {**GOVERNING, **NODES, **CUSTODY, **TOOLS},
    "Contracts": CONTRACTS,
    "Showing a network": LAB,
}
"""The answers of commands, under the headings of the page."""

NOT_LISTED: Mapping[str, str] = {
    "custody status": "[look after custodians](../how-to/custody.md)",
    "custody scrub": "[look after custodians](../how-to/custody.md)",
    "custody rebuild": "[look after custodians](../how-to/custody.md)",
    "demo": "[commands](cli.md#demo)",
    "experiment": "[commands](../how-to/run-the-experiments.md)",
    "bench": "[commands](cli.md#measuring): `name`, `figures` and `conditions`, which differ from one to the other",
    "privacy attack": "[commands](cli.md#privacy-attack): likewise",
    "sim run": "[commands](cli.md#sim-run): likewise",
    "sim calibrate": "[commands](cli.md#sim-calibrate): likewise",
}
"""Commands, or groups of them, whose fields the page does not list, and where something is said of them."""

_INTRODUCTION = """\
<!-- Made from the code by `blockrobot reference`. Do not edit. -->

# What commands answer with `--json`

One JSON object on standard output, and nothing else there; what is noted on the way goes to standard error. Where a
command prints an object on each line instead, the table says so.

- **Every field of an answer**, with its type, unit and meaning, is in
  [json-output.schema.json](json-output.schema.json) (JSON Schema 2020-12): under `commands` by the command's words,
  which refer into `$defs` by the names below. `jq '."$defs".BreachAnswer' docs/reference/json-output.schema.json`
- **`ok`** is in every answer, and true unless the table says when it is not.
- **A refusal** is `{"ok": false, "error": {"code", "detail", "next_step"}}`, with an [exit code](cli.md) other than 0.
  The codes are in the [catalogue of errors](errors.md). Branch on `code`: the texts may change.
- **Every field is always there** unless the schema does not require it, and never null unless its type says so; the
  description says when. Lists may be empty.
- **Hexadecimal** is in lower case, two digits a byte. **Times in ms** are milliseconds since 1970 (UTC), by the
  clock of the chain unless another is named. A **block height** counts from 0, which is genesis.
- **Texts** for people are in English, whatever `--language` says. Codes and states stand in `code marks`.
- Later versions may add fields: take what you know, and leave the rest. In 0.x a field may also go; the
  [changelog](../../CHANGELOG.md) then says so."""


def listed_answers() -> AnswersByCommand:
    return {words: answer for answers in SECTIONS.values() for words, answer in answers.items()}


def write_json_schema() -> str:
    """`docs/reference/json-output.schema.json`."""
    return json.dumps(write_schema(listed_answers()), indent=1, ensure_ascii=False) + "\n"


def _table(answers: AnswersByCommand) -> list[str]:
    rows = [
        f"| `{words}` | `{kind.__name__}` | {' '.join(str(inspect.getdoc(kind)).split())} |"
        for words, answer in answers.items()
        for kind in list_kinds(answer)
    ]
    return ["| command | answer | |", "|---|---|---|", *rows, ""]


def write_json_page() -> str:
    """`docs/reference/json-output.md`."""
    lines = [_INTRODUCTION, ""]
    for heading, answers in SECTIONS.items():
        lines += [f"## {heading}", "", *_table(answers)]
    lines += ["## Not listed here", "", "These answer with `--json` too. Their fields are not listed on this page:", ""]
    lines += ["| commands | what is said of them |", "|---|---|"]
    lines += [f"| `{commands}` | {where} |" for commands, where in NOT_LISTED.items()]
    return "\n".join(lines).rstrip() + "\n"
