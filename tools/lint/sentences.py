"""Sentences of more than 40 words in Markdown, and pages beyond their length, are printed; exit code 1 if there are any.

A colon does not end one, except where a list or a block follows.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

MOST = 40  # words
LONGEST = {'docs/results.md': 1500}  # words of a page
CODE = re.compile(r'^```.*?^```|<!--.*?-->', re.MULTILINE | re.DOTALL)
# A line that begins a list, a heading, a table, a quotation or an indented block ends what stands before it, as an empty one.
BREAK = re.compile(r'\n\s*\n|\n(?=\s*(?:[-*+|#>]|\d+\.\s)|\s{4,})')
END = re.compile(r'(?<=[.!?])["*)_\]]*\s+')


def sentences(text: str) -> Iterator[tuple[int, str]]:
    """Each sentence of a page with the number of its first line; cells of tables are not sentences.

    Parameters:
        text: of the page.
    """
    text = CODE.sub(lambda found: re.sub(r'[^\n]', ' ', found[0]), text)
    start = 0
    for part in [*BREAK.finditer(text), None]:
        block, begin = text[start:part.start() if part else len(text)], start
        start = part.end() if part else len(text)
        if block.lstrip().startswith('|'):
            continue
        place = 0
        for sentence in END.split(block):
            place = block.index(sentence, place)
            yield text[:begin + place].count('\n') + 1, sentence
            place += len(sentence)


def words(sentence: str) -> int:
    """Number of words: code, links and formulas count as one."""
    plain = re.sub(r'\]\([^)]*\)', ']', re.sub(r'`[^`]*`', 'code', sentence))
    return len([word for word in plain.split() if re.search(r'\w', word)])


def main() -> int:
    """Check every page that git knows; returns the exit code."""
    files = subprocess.check_output(['git', 'ls-files', '*.md'], text=True).splitlines()
    found = [f'{file}:{line}: {count} words: {sentence[:60].strip()!r} ...'
             for file in files if Path(file).exists() for line, sentence in sentences(Path(file).read_text())
             if (count := words(sentence)) > MOST]
    found += [f'{file}: {count} words, expected at most {most}'
              for file, most in LONGEST.items() if (count := words(Path(file).read_text())) > most]
    print(*found, sep='\n', end='\n' if found else '')
    return bool(found)


if __name__ == '__main__':
    sys.exit(main())
