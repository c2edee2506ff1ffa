"""Load a Python object that a user names in a file: FILE.py:OBJECT or MODULE:OBJECT."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.extras import needed_by
from freeflyer.foundation.plugins import described


def load(text: str, folder: Path) -> Any:
    """Return the object that `text` names. A relative path FILE.py is relative to `folder`.

    Raises CosimError if the file or the object does not exist, or if its module raises any
    exception. Raises MissingExtra if the module needs an extra that is not installed.
    """
    where, _, attribute = text.rpartition(":")
    try:
        is_file = where.endswith(".py")
        with needed_by(text):
            module = loaded(folder / where) if is_file else importlib.import_module(where)
            return getattr(module, attribute)
    except CosimError:
        raise
    except (Exception, SystemExit) as error:  # user code can raise anything
        raise CosimError(f"{text} cannot be used: {described(error)}") from error


def loaded(path: Path) -> ModuleType:
    """Execute a Python file as a module. Raises CosimError if the file does not exist."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise CosimError(f"{path} does not exist")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
