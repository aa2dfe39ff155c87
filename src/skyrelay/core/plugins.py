"""Code that a user names: what is installed under an entry point, or ``module:attribute``.

A name is data, and data may come from anywhere: a scenario of somebody else's, a run folder, a chain. Code is loaded
only for what the user has named in this process, by a command's option, by ``--set`` or by a call; an entry point is
installed by the user, so that its name is enough.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import inspect
import re
import sys
from collections.abc import Collection, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from skyrelay.core.errors import UsageError

CODE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
"""``module:attribute``."""

_named: set[str] = set()
_given: dict[str, Any] = {}


def is_code(name: str) -> bool:
    """Whether a name is ``module:attribute``."""
    return len(name) <= 200 and CODE.fullmatch(name) is not None


def allow(name: str) -> None:
    """The user has named this code."""
    if is_code(name):
        _named.add(name)


def given(value: Any) -> str:
    """A name for code that a call hands over, by which `load` finds it in this process."""
    kind = value if hasattr(value, "__qualname__") else type(value)
    path = re.sub(r"\W+", "_", kind.__qualname__).strip("_")
    name = f"{re.sub(r'[^A-Za-z0-9_.]+', '_', kind.__module__)}:{path}"
    _given[name] = value
    _named.add(name)
    return name


def installed(group: str) -> list[str]:
    """Names of the entry points of a group."""
    return sorted({entry.name for entry in entry_points(group=group)})


def load(group: str, name: str, shipped: Mapping[str, str], place: str, others: Collection[str] = ()) -> Any:
    """What a name stands for: of this package, of another one's entry points, or code that the user has named.

    Args:
        group: of entry points, e.g. ``"skyrelay.policies"``.
        shipped: ``module:attribute`` of this package's own, by name.
        place: what an error calls the name, e.g. ``"coordination.policy"``.
        others: names that fit there, too; for suggestions.
    Raises:
        UsageError: there is none of that name, it cannot be loaded, or the user has not named it.
    """
    if name in _given:
        return _given[name]
    if name in shipped:
        return _attribute(shipped[name], place)
    found = [entry for entry in entry_points(group=group) if entry.name == name]
    if found:
        return _attribute(found[0].value, place)
    if is_code(name):
        if name not in _named:
            raise UsageError(place, name, "code that you name yourself, on the command line: a file's is not loaded")
        return _attribute(name, place)
    known = [*others, *shipped, *installed(group)]
    close = difflib.get_close_matches(name.lower(), known, n=1)
    hint = f"a known name: did you mean {close[0]!r}?" if close else f"one of {', '.join(known)}, or module:attribute"
    raise UsageError(place, name, hint)


def fingerprint(loaded: Any) -> str | None:
    """SHA-256 of the file that code is in; None where there is none."""
    try:
        file = inspect.getsourcefile(loaded if not hasattr(loaded, "__dict__") else inspect.unwrap(loaded))
    except TypeError:
        file = inspect.getsourcefile(type(loaded))
    if file is None or not Path(file).is_file():  # typed into a notebook or a shell
        return None
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def fault(error: BaseException) -> str:
    """What own code ended with, on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:160]


def _attribute(reference: str, place: str) -> Any:
    module, _, path = reference.partition(":")
    here = str(Path.cwd())
    added = here not in sys.path and "" not in sys.path
    if added:
        sys.path.append(here)  # last, so that a file here hides no installed package
    try:
        value: Any = importlib.import_module(module)
        for part in path.split("."):
            value = getattr(value, part)
    except ModuleNotFoundError as error:
        if error.name is not None and (module == error.name or module.startswith(f"{error.name}.")):
            raise UsageError(place, reference, f"a module that can be imported here ({fault(error)})") from error
        raise  # what it lacks may be one of this package's extras
    except AttributeError as error:
        raise UsageError(place, reference, f"a name in that module ({fault(error)})") from error
    except UsageError:
        raise
    except Exception as error:  # whatever a module does when it is imported
        raise UsageError(place, reference, f"a module that can be imported ({fault(error)})") from error
    finally:
        if added:
            sys.path.remove(here)
    return value
