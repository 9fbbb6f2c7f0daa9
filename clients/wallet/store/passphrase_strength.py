"""Strength checks for passphrases, after NIST SP 800-63B-4, section 3.1.1.2.

The minimum for a stand-alone password holds, as a stolen file can be attacked offline.
"""

from __future__ import annotations

import enum
import unicodedata

from clients.wallet.present.translations import refusal

PASSPHRASE_MIN_LETTERS = 15
PARTS_MIN_COUNT = 8
"""What is written out of so few common words, rows of keys and repetitions is guessed soon, however long it is."""
LONG_PARTS_COUNT = 15
JUDGED_MAX_LETTERS = 128
_RUN_MIN_LETTERS = 3

_ROWS = (
    "abcdefghijklmnopqrstuvwxyz",
    "01234567890",
    "qwertyuiop",
    "asdfghjklç",
    "asdfghjkl;",
    "zxcvbnm,.",
    "!@#$%^&*()",
)
# Those that lead the lists of leaked passwords, and what lies near here. In two languages, as the wallet speaks them.
_LISTED = """
password passw0rd passwort pass word secret letmein welcome admin administrator login master monkey dragon football
baseball basketball soccer hockey sunshine princess superman batman iloveyou love loveyou trustno1 shadow michael
jordan jennifer charlie daniel jessica ashley summer winter spring autumn january monday freedom whatever hello
qazwsx 1q2w3e 1q2w3e4r 1q2w3e4r5t zaq12wsx qwe123 abc123 a1b2c3 test testing guest changeme default computer
internet google samsung starwars pokemon cookie flower mustang killer hunter pepper ginger family mother house
passphrase phrase blockrobot block robot wallet hospital patient tag card
senha palavra frase passe segredo carteira benfica sporting porto portugal brasil lisboa amor teamo amote meuamor
gabriel joana maria pedro futebol estrela familia obrigado bemvindo ola casa verao inverno cartao paciente
correcthorsebatterystaple
"""
_LOOKALIKES = str.maketrans("@0$315l", "aoseisi")
"""What people put for a letter; `l` too, since 1 stands for both `i` and `l`."""
_WORDS = frozenset(word.translate(_LOOKALIKES) for word in _LISTED.split())
_WORD_MAX_LETTERS = max(map(len, _WORDS))


class Strength(enum.Enum):
    """What is known of an accepted passphrase; none is called good."""

    FAIR = "fair"
    LONG = "long"


def judge_passphrase(passphrase: str) -> Strength:
    """Judge a new passphrase. Raises PASSPHRASE_WEAK for a short or common one."""
    letters = count_letters(passphrase)
    if letters < PASSPHRASE_MIN_LETTERS:
        raise refusal("PASSPHRASE_WEAK", "passphrase_short", count=letters, least=PASSPHRASE_MIN_LETTERS)
    count = count_parts(passphrase)
    if count < PARTS_MIN_COUNT:
        raise refusal("PASSPHRASE_WEAK", "passphrase_common")
    return Strength.FAIR if count < LONG_PARTS_COUNT else Strength.LONG


def count_letters(passphrase: str) -> int:
    return len(unicodedata.normalize("NFC", passphrase))


def count_parts(passphrase: str) -> int:
    """Return the fewest parts of a passphrase, each about as hard to guess as one random letter; at most 128 letters
    count.

    A part: letter, common word (also with @ or 0), keyboard or alphabet run, repeated letter, earlier text. Blanks and
    dashes between words are ignored.
    """
    folded = unicodedata.normalize("NFKC", passphrase).casefold()
    bare = "".join(letter for letter in folded if not letter.isspace() and letter not in "-_.,")
    judged = (bare or folded)[:JUDGED_MAX_LETTERS]
    spelled = judged.translate(_LOOKALIKES)
    fewest = [0]
    for end in range(1, len(judged) + 1):
        best = fewest[end - 1] + 1
        for start in range(end - 2, -1, -1):
            if fewest[start] + 1 < best and _is_one_part(judged, spelled, start, end):
                best = fewest[start] + 1
        fewest.append(best)
    return fewest[-1]


def _is_one_part(text: str, spelled: str, start: int, end: int) -> bool:
    part = text[start:end]
    if len(part) <= _WORD_MAX_LETTERS and spelled[start:end] in _WORDS:
        return True
    if len(part) < _RUN_MIN_LETTERS:
        return False
    return len(set(part)) == 1 or part in text[: end - 1] or any(part in row or part[::-1] in row for row in _ROWS)
