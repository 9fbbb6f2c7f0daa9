"""The doctor's checks of uploads at custodians."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.errors import BlockRobotError
from network.custody.asking import ask_all
from network.custody.upload_telling import find_upload_troubles
from network.doctor.answers import Answer
from network.doctor.findings import Finding
from node.config import NodeConfig


async def check_uploads(configs: Sequence[NodeConfig], answers: Sequence[Answer]) -> list[Finding]:
    running = {answer.name for answer in answers if answer.status is not None}
    custodians = [config for config in configs if config.custodian_key_path is not None and config.name in running]
    found = []
    for config, told in zip(custodians, await ask_all(custodians), strict=True):
        if isinstance(told, BlockRobotError):
            found.append(Finding("CUSTODY_SILENT", config.name, f"{told.detail} ({told.code})"))
        else:
            found += [Finding(code, config.name, sentence) for code, sentence in find_upload_troubles(told)]
    return found
