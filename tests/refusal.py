"""Refusals of logs, as the tests of what reads them look at them."""

import pytest

from sysid.columns.header import contract_plan
from sysid.columns.unknown import drafted
from sysid.logs.log import LogError
from sysid.logs.read import read_logs
from sysid.tables.cells import Dialect
from sysid.tables.head import open_head


def refused(paths, *words, **options):
    """The error of reading one path or several, with all these words in it."""
    with pytest.raises(LogError) as error:
        read_logs(paths if isinstance(paths, list) else [paths], **options)
    message = str(error.value)
    assert all(str(word) in message for word in words), message
    return error.value


def draft_of(path):
    """The mapping file that is drafted for a file, whether or not it is read without one."""
    head = open_head(str(path), Dialect())
    try:
        contract_plan(head)
    except LogError as error:
        return error.mapping or drafted(head)
    return drafted(head)


def changed(text, old, new):
    """The text with one thing wrong in it."""
    assert old in text
    return text.replace(old, new)
