# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The prose that users read, sentence by sentence: pages, messages, helps, texts of the code."""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator

#: Words of a sentence, at most. A code span, or a list of them, counts as one.
MOST_WORDS = 30
#: Words that no user reads: each has a plain one, as docs/glossary.md has it.
BANNED = re.compile(
    r"\b(told|heed\w*|beside|else|made up for|taken off|what is not|by the way|way in|see way"
    r"|silent errors?|a contact is said)\b",
    re.IGNORECASE,
)
_CODE = "CODE"
#: A full stop that ends no sentence.
_ABBREVIATION = re.compile(r"\b(e\.g|i\.e|et al|eq|eqs|Phys|Rev|Dr|vs|No|cf)\.")


def sentences(text: str) -> list[str]:
    """Return the sentences of one paragraph, list item or cell, its code spans as one word."""
    text = re.sub(r"``.+?``|`[^`]*`", _CODE, text)
    text = re.sub(rf"{_CODE}(?:(?:,| and| or|,? \.\.\.)? {_CODE})+", _CODE, text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"https?://\S+", _CODE, text)
    text = _ABBREVIATION.sub(r"\1", text)
    text = re.sub(r"[*_]{2}|(?<!\w)\*|\*(?!\w)", "", text)
    return [one for one in re.split(r"(?<=[.!?])[)\"']*\s+", " ".join(text.split())) if one]


def word_count(sentence: str) -> int:
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def page_units(text: str) -> Iterator[str]:
    """Yield the headings, paragraphs, list items and cells of a page, without its code blocks."""
    unit: list[str] = []
    in_code, after_blank = False, True
    for line in text.splitlines():
        fence = line.lstrip().startswith(("~~~", "```"))
        in_code ^= fence
        indent = len(line) - len(line.lstrip())
        is_item = bool(re.match(r"\s*(?:[-*]|\d+\.) ", line))
        is_code = in_code or fence or (indent >= 4 and after_blank and not is_item)
        if line.startswith("|"):
            yield from _ended(unit)
            cells = re.split(r"(?<!\\)\|", line)[1:-1]
            yield from (cell.strip() for cell in cells if not re.fullmatch(r"[\s:-]*", cell))
        elif is_code or not line.strip() or line.startswith("#") or is_item:
            yield from _ended(unit)
            if line.startswith("#"):
                yield line.lstrip("# ")
            elif is_item:
                unit.append(re.sub(r"^\s*(?:[-*]|\d+\.) ", "", line))
        else:
            unit.append(line.strip())
        # A block of code goes on over blank lines.
        after_blank = not line.strip() or line.startswith("#") or is_code
    yield from _ended(unit)


def _ended(unit: list[str]) -> Iterator[str]:
    if unit:
        yield " ".join(unit)
        unit.clear()


def comment_units(message: str) -> Iterator[str]:
    """Yield the comments of a message, with the lines that go on with one."""
    unit: list[str] = []
    for line in message.splitlines():
        code, mark, comment = line.partition("#")
        goes_on = mark and not code.strip() and comment.strip()
        if not goes_on or (unit and bool(code) != line.startswith(" ")):
            yield from _ended(unit)
        if comment.strip():
            unit.append(comment.strip())
    yield from _ended(unit)


def help_units(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the texts of a command's --help and of all its subcommands, less their examples."""
    for text in (parser.description, parser.epilog):
        for block in re.split(r"\n\s*\n", text or ""):
            yield " ".join(line for line in block.splitlines() if not line.startswith(" "))
    for action in parser._actions:
        if action.help and action.help != argparse.SUPPRESS:
            yield action.help
        if isinstance(action, argparse._SubParsersAction):
            yield from (one.help or "" for one in action._choices_actions)
            for command in action.choices.values():
                yield from help_units(command)


def text_units(source: str) -> Iterator[str]:
    """Yield the texts of a module that have words: its strings, but for docstrings."""
    tree = ast.parse(source)
    left_out: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            left_out.add(id(node.value))
        if isinstance(node, ast.JoinedStr):
            left_out.update(id(part) for part in ast.walk(node) if part is not node)
    for node in ast.walk(tree):
        if id(node) in left_out:
            continue
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
        elif isinstance(node, ast.JoinedStr):
            parts = (p.value if isinstance(p, ast.Constant) else _CODE for p in node.values)
            text = "".join(str(part) for part in parts)
        else:
            continue
        for block in re.split(r"\n\s*\n|\n(?=\s)", text):
            if re.search(r"[A-Za-z]+ [a-z]+ ", block) and not block.startswith((" ", "#")):
                yield block
