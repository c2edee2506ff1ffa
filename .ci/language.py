"""Find words that stand for persons, where a component, process or file is meant.

Usage: python .ci/language.py [PATH ...]    (default: code, documents, and names of tests)

A phrase of language_exceptions.txt is allowed. So is a line with the marker `language: person`.
The exit code is 1 if a word is found.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
WORDS = (
    "who|whom|whoever|somebody|someone|nobody|anybody|anyone|everybody|everyone|strangers?|"
    "witness|witnesses|eyes?|ears?|deaf|words?|says?|said|tells?|told|hears?|heard|"
    "forgets?|forgot|forgotten|hands?|oracle|twins?|mended|swells?"
)
# "_" is not a part of a word here, so that names of variables and functions are read too.
PATTERN = re.compile(rf"(?<![A-Za-z])({WORDS})(?![A-Za-z])", re.IGNORECASE)
PERSON = "language: person"
SUFFIXES = {".py", ".pyi", ".c", ".h", ".md", ".toml", ".jinja", ".cff"}


def exceptions() -> re.Pattern[str]:
    """One pattern for all allowed phrases; `#` starts a comment."""
    lines = (ROOT / ".ci" / "language_exceptions.txt").read_text(encoding="utf-8").splitlines()
    phrases = [phrase for line in lines if (phrase := line.partition("#")[0].strip())]
    return re.compile(
        "|".join(map(re.escape, sorted(phrases, key=len, reverse=True))), re.IGNORECASE
    )


def main(arguments: list[str]) -> int:
    """Print `PATH:LINE: WORD: TEXT` for every word that is found."""
    chosen = arguments or [
        "cosim",
        "fmu_src",
        "adapters",
        "docs",
        "tests",
        "*.md",
        "pyproject.toml",
    ]
    listed = subprocess.run(
        ["git", "ls-files", *chosen], cwd=ROOT, capture_output=True, text=True, check=True
    )
    allowed, found = exceptions(), 0
    for name in listed.stdout.splitlines():
        path = ROOT / name
        if path.suffix not in SUFFIXES or name == "CHANGELOG.md":
            continue
        only_test_names = name.startswith("tests/")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if PERSON in line or (only_test_names and not line.lstrip().startswith("def test_")):
                continue
            for word in PATTERN.findall(allowed.sub("", line)):
                print(f"{name}:{number}: {word}: {line.strip()[:120]}")
                found += 1
    if found:
        print(f"{found} words that stand for persons: see CONTRIBUTING.md, Language")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
