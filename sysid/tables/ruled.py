"""Tables that are drawn: bars between the cells and around them, lines of dashes between the rows, as
databases, Markdown and reStructuredText have them. Their bytes without what is drawn,
a row a line as it stood."""

import re

_HINTS = (b"--", b"==", b"\n|", "─".encode(), "━".encode(), "═".encode())
_BAR = re.compile("│|┃|┆|║".encode())
_OTHER = re.compile(rb"\xe2[\x94\x95][\x80-\xbf]")  # signs that boxes are drawn with
# dashes with a bar or a cross where columns meet
_RULE = re.compile(rb"^(?=[^\n]*(?:--|==|:-|-:))(?=[^\n]*[|+])[|+=: \t-]+\r?$", re.MULTILINE)
# dashes alone, below names and above numbers; the same may stand above and below the table
_BELOW_NAMES = re.compile(rb"(?<=\n)[ \t]*[-=]{2,}(?:[ \t]+[-=]{2,})+[ \t]*\r?(?=\n[ \t]*[-+.\d])")
_AROUND = re.compile(rb"^[ \t]*\|(.*?)\|?[ \t]*\r?$", re.MULTILINE)
_ROWS = re.compile(rb"^\|[^\n]+\|[ \t]*\r?\n\|[ \t]*[-+.]?\d[^\n]*\|[ \t]*\r?$", re.MULTILINE)
_ESCAPED = re.compile(
    rb"(?<=\|)((?:[^|\n\\]|\\.)*\\\|(?:[^|\n\\]|\\.)*)(?=\|)"
)  # a cell with a bar of its own


def is_ruled(text: bytes) -> bool:
    """Whether a text, or its beginning, holds a table that is drawn."""
    if not text.startswith(b"|") and not any(hint in text for hint in _HINTS):
        return False
    text = _plain_signs(text)
    return any(form.search(text) for form in (_RULE, _BELOW_NAMES, _ROWS))


def unruled(text: bytes) -> bytes:
    """Such a text with blank lines for its rules, and rows whose cells bars part, if any."""
    text = _RULE.sub(b"", _plain_signs(text))
    if found := _BELOW_NAMES.search(text):
        text = re.sub(rb"(?m)^" + re.escape(found[0]) + rb"$", b"", text)
    return _AROUND.sub(rb"\1", _ESCAPED.sub(_quoted, text) if rb"\|" in text else text)


def _plain_signs(text: bytes) -> bytes:
    return _OTHER.sub(b"--+", _BAR.sub(b"|", text)) if b"\xe2" in text else text


def _quoted(cell: re.Match[bytes]) -> bytes:
    return b'"' + cell[1].strip().replace(rb"\|", b"|") + b'"'
