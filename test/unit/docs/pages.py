"""The documentation pages, parsed for the tests."""

import re
from pathlib import Path

REPO = Path(__file__).resolve().parents[3]
PAGES = (REPO / "README.md", *sorted((REPO / "doc").glob("*.md")))
CODE = re.compile(r"^```(\S*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def name_of(page):
    return page.relative_to(REPO).as_posix()


def blocks(page, language):
    """Contents of the code blocks of one language."""
    text = page.read_text(encoding="utf-8")
    return [content for found, content in CODE.findall(text) if found == language]


def prose(page):
    """Text without code blocks."""
    return CODE.sub("", page.read_text(encoding="utf-8"))


def command_lines(page):
    """Commands of the shell blocks in the order of the page, one line each, without comments."""
    lines = []
    for block in blocks(page, "sh"):
        for line in re.sub(r"\\\n\s*", "", block).splitlines():
            lines += [part.strip() for part in re.sub(r"\s#.*$", "", line).split("&&")]
    return [line for line in lines if line]


def anchors(page):
    """Anchors of the headings, as GitHub and MyST make them."""
    titles = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-") for title in titles}
