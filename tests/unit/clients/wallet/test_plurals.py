"""One of a thing is said in the singular, in every text of the catalogue, in both languages."""

from __future__ import annotations

import re
import string

import pytest

from clients.wallet.presentation.translations import LANGUAGES
from clients.wallet.text_catalogue import ONE, load

COUNTED = frozenset(
    {
        *("count", "done", "of", "number", "given", "held", "total", "needed", "confirmed", "whole", "handed", "here"),
        *("shown", "minutes", "seconds", "visits", "records", "pictures", "events", "things"),
    }
)
"""Values that say how many there are of something."""
NEVER_ONE = (
    *("because.several.", "because.short.", "guardians.", "usage.guardians_needed", "usage.former_words", "sheet."),
    *("linked.acting", "linked.moving", "page.erase.joined", "passphrase.wanted", "rotate.progress"),
    "ask.scanned",
)
"""Of what is always more than one: guardians, a name's letters; of seconds, of 24 words together, of 10,000 entries."""
SINGULARS = {"en": {"was", "is", "has", "holds", "gets", "obeys"}, "pt": {"delas", "destas", "dos"}}
"""Words that stand behind a singular though they end as a plural does: `1 delas`, `1 dos seus encontros`."""


class _OneOfEach(string.Formatter):
    """Puts 1 in for whatever is counted, and a letter for all else."""

    def get_value(self, key: int | str, args: object, kwargs: object) -> object:
        return 1 if key in COUNTED else "x"


def said_of_one(language: str) -> dict[str, str]:
    """Return every text as it is said of one of each thing."""
    return {
        key: _OneOfEach().format(form if isinstance(form, str) else form[ONE])
        for key, form in load(language).items()
        if not key.startswith((*NEVER_ONE, "help.", "errors.", "refusals."))
    }


@pytest.mark.parametrize("language", LANGUAGES)
def test_one_of_a_thing_is_never_said_in_the_plural(language: str) -> None:
    wrong = {
        key: told
        for key, told in said_of_one(language).items()
        for word in re.findall(r"(?<![\d.:/+-])\b1 ([^\W\d_]+s)\b", told)
        if word not in SINGULARS[language]
    }
    assert wrong == {}
