"""Strength checks for passphrases, after NIST SP 800-63B-4, section 3.1.1.2.

The minimum for a stand-alone password holds, as a stolen file can be attacked offline.
"""

from __future__ import annotations

import enum
import math
import unicodedata

from clients.wallet.text_catalogue import refusal

PASSPHRASE_MIN_LETTERS = 15
FAIR_MIN_GUESSES = 10**10
"""Fewer are refused at any length."""
LONG_MIN_GUESSES = 10**14
JUDGED_MAX_LETTERS = 72
"""zxcvbn's time grows faster than the square of the length."""

# zxcvbn knows leaked passwords and English only.
_NEAR_HERE = """
amor amote bemvindo benfica blockrobot brasil carteira cartao casa estrela familia frase futebol hospital lisboa meuamor
obrigado paciente palavra passe passphrase patient portugal robot segredo senha sporting teamo wallet
correcthorsebatterystaple
"""


class Strength(enum.Enum):
    """What is known of an accepted passphrase; none is called good."""

    FAIR = "fair"
    LONG = "long"


def judge_passphrase(passphrase: str) -> Strength:
    """Raises PASSPHRASE_WEAK for a short or common one."""
    letters = count_letters(passphrase)
    if letters < PASSPHRASE_MIN_LETTERS:
        raise refusal("PASSPHRASE_WEAK", "passphrase_short", count=letters, least=PASSPHRASE_MIN_LETTERS)
    guesses = count_guesses(passphrase)
    if guesses < FAIR_MIN_GUESSES:
        raise refusal("PASSPHRASE_WEAK", "passphrase_common")
    return Strength.FAIR if guesses < LONG_MIN_GUESSES else Strength.LONG


def count_letters(passphrase: str) -> int:
    return len(unicodedata.normalize("NFC", passphrase))


def count_guesses(passphrase: str) -> int:
    """The product of what zxcvbn finds for the parts; blanks and dashes are ignored."""
    from zxcvbn import zxcvbn  # noqa: PLC0415 - its lists take long to load

    folded = unicodedata.normalize("NFKC", passphrase).casefold()
    bare = "".join(letter for letter in folded if not letter.isspace() and letter not in "-_.,")
    parts = zxcvbn((bare or folded)[:JUDGED_MAX_LETTERS], user_inputs=_NEAR_HERE.split())["sequence"]
    # Not its sum: that adds 10,000 for each part, so four common words would do.
    return math.prod(int(part["guesses"]) for part in parts)
