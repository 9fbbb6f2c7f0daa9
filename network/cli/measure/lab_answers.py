"""What `blockrobot lab` answers with `--json`."""

from __future__ import annotations

from typing import Annotated, Any

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, doc
from network.lab.year.figures import HospitalYearAnswer


class HostStoriesAnswer(Answer, frozen=True, kw_only=True):
    """The stories of several hosts."""

    stories: Annotated[dict[str, str], doc("What happens in each, by its name")]


class HostStoryAnswer(Answer, frozen=True, kw_only=True):
    """A story that was played. `ok` is false if something did not go as it should."""

    name: Annotated[str, doc("The story")]
    failures: Annotated[list[str], doc("What did not go as it should, a sentence each")]
    figures: Annotated[
        dict[str, Any], doc("What was seen and what was there at the end: fields that differ from story to story")
    ]
    conditions: Annotated[dict[str, Any], doc("What it was measured under: cores, load, versions")]


ANSWERS: AnswersByCommand = {"lab hosts": (HostStoriesAnswer, HostStoryAnswer), "lab year": HospitalYearAnswer}
